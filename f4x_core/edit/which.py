"""Questions about a thing that is named in the singular where a scene has more of its kind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..language.lexicon import UNCOUNTED, plural_of, singular
from .change import Change
from .description import in_words
from .records import mapped
from .selects import And, Beside, Instance, Not, Or, Part, SelectKind, Text, parts_of

if TYPE_CHECKING:
    from ..scene import Scene

PLACES = {2: ("left", "right"), 3: ("left", "middle", "right")}
"""Number of things -> the places that tell them apart."""
MANY = ("left", "right", "nearest", "largest")
"""Places offered where there are more."""
FRAMES = 24
"""Frames, evenly over the clip, in which things are looked for that the present one does not show."""


class Several(F4xError):  # noqa: N818  # nothing went wrong
    """One of several things is meant, and a sentence does not say which."""

    def __init__(self, reason: str, commands: tuple[str, ...]):
        """Give the reason; `commands`: one for each thing that may be meant, and one for all."""
        super().__init__(reason)
        self.reason, self.commands = reason, commands


def asked_about(operation: Change) -> Iterator[SelectKind]:
    """Yield the selections of an operation that must be certain of which thing they mean, in the words of a sentence."""
    if operation.removes:
        yield from _certain(operation.select)
    else:
        yield from (one for part in _beside_in(operation.select) for one in _certain(part))
    for name in ("other", "beside"):
        if (other := getattr(operation, name, None)) is not None:
            yield from _certain(other)


def _certain(select: SelectKind) -> Iterator[SelectKind]:
    """Yield the parts of a selection that name one thing of a kind without saying which."""
    if isinstance(select, Text):
        yield from (
            replace(select, labels=(label,), single=(label,))
            for label in select.single
            if label.split()[-1] not in UNCOUNTED
        )
    elif isinstance(select, And) and any(isinstance(part, Text) and part.single for part in select.of):
        things = tuple(part for part in select.of if not (isinstance(part, Not) and _is_words(part.of)))
        if all(not isinstance(part, Not) for part in things):  # "the car but not its shadow" is a car
            yield from _certain(things[0]) if len(things) == 1 else (And(things),)
    elif isinstance(select, Or | And):
        for part in select.of:
            yield from _certain(part)
    elif isinstance(select, Not | Part):
        yield from _certain(select.of)
    elif isinstance(select, Beside):
        yield from _certain(select.other)


def _is_words(select: SelectKind) -> bool:
    """Return True if a selection is of words alone."""
    return all(isinstance(part, Or | Text) for part in parts_of(select))


def _beside_in(select: SelectKind) -> Iterator[SelectKind]:
    """Yield the things in a selection beside which something stands."""
    if isinstance(select, Beside):
        yield select.other
    of = getattr(select, "of", ())
    for part in of if isinstance(of, tuple) else (of,):
        yield from _beside_in(part)


def frame_of_most(scene: Scene, rows: np.ndarray, owner: np.ndarray, present: int) -> int:
    """Return the clip frame, the present one or the nearest of some, in which most of several things are in the picture.

    `owner (n,)`: number of the thing that each of the Gaussians `rows (n,)` belongs to.
    """
    things = owner.max() + 1

    def seen(time: float) -> int:
        means, camera = scene.posed(time).means[rows], scene.cameras.at(time)
        pixels, depth = camera.project(np.stack([np.median(means[owner == n], 0) for n in range(things)]))
        inside = (pixels >= 0) & (pixels < (camera.width, camera.height))
        return int((inside.all(1) & (depth > 0)).sum())

    if seen(present) == things:
        return present
    times = scene.cameras.times[evenly_spaced(len(scene.cameras), FRAMES)]
    return max([present, *sorted(map(round, times.tolist()), key=lambda time: abs(time - present))], key=seen)


def which_of(operations: Sequence[Change], select: SelectKind, many: int, frame: int | None) -> Several:
    """Return the question which of `many` things of a kind is meant, with a command for each and one for all.

    `frame`: the one through which their places are seen; None for the present one, which is not named.
    """
    text = next(part for part in (select, *getattr(select, "of", ())) if isinstance(part, Text))
    noun = plural_of(singular(text.labels[0]))
    places = PLACES.get(many, MANY)
    meant: list[SelectKind] = [Instance(Text(text.labels), place, frame or 0) for place in places]  # type: ignore[arg-type]
    commands = [_with(operations, text, one) for one in meant]
    every = f"{'both' if many == 2 else 'all the'} {noun}"
    commands.append([re.sub(rf"\bthe {re.escape(text.labels[0])}\b", every, line) for line in _lines(operations)])
    offered = tuple("; ".join(lines) for lines in commands)
    if frame is None:
        offered = tuple(re.sub(r" of frame \d+", "", command) for command in offered)
    return Several(f"There are {many} {noun} in the scene, and it is not said which one is meant.", offered)


def _lines(operations: Sequence[Change]) -> list[str]:
    return [in_words([one]) for one in operations]


def _with(operations: Sequence[Change], text: Text, one: SelectKind) -> list[str]:
    """Return the operations in words, with another selection in place of a named thing."""

    def changed(value: Any) -> Any:
        if isinstance(value, Text) and text.labels[0] in value.single:
            others = tuple(label for label in value.labels if label != text.labels[0])
            return Or((one, replace(value, labels=others))) if others else one
        return None

    return _lines([mapped(operation, changed) for operation in operations])
