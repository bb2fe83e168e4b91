"""Questions about a thing that is named in the singular where a scene has more of its kind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from ..errors import F4xError
from ..language.cast_words import is_cast
from ..language.lexicon import UNCOUNTED, plural_of, singular
from .change import Change
from .description import in_words
from .records import mapped
from .selects import And, Beside, Instance, Not, Or, Part, SelectKind, Text, parts_of

PLACES = {2: ("left", "right"), 3: ("left", "middle", "right")}
"""Number of things -> the places that tell them apart."""
MANY = ("left", "right", "nearest", "largest")
"""Places offered where there are more."""


class Several(F4xError):  # noqa: N818  # nothing went wrong
    """One of several things is meant, and a sentence does not say which."""

    def __init__(self, reason: str, commands: tuple[str, ...]):
        """`commands`: one for each that may be meant, and one for all."""
        super().__init__(reason)
        self.reason, self.commands = reason, commands


def removes(operation: Change) -> bool:
    """Return True where the operation makes something invisible."""
    return operation.removes


def asked_about(operation: Change) -> Iterator[SelectKind]:
    """The selections of an operation of which it has to be certain whom they mean, in the words of a sentence."""
    if removes(operation):
        yield from _certain(operation.select)
    else:
        yield from (one for part in _beside_in(operation.select) for one in _certain(part))
    for name in ("other", "beside"):
        if (other := getattr(operation, name, None)) is not None:
            yield from _certain(other)


def _certain(select: SelectKind) -> Iterator[SelectKind]:
    """The parts of a selection that name one thing of a kind; not the kinds that something else tells one from."""
    if isinstance(select, Text):
        yield from (
            replace(select, labels=(label,), single=(label,))
            for label in select.single
            if label.split()[-1] not in UNCOUNTED
        )
    elif isinstance(select, And) and any(isinstance(part, Text) and part.single for part in select.of):
        if all(
            _is_shadow(part.of) for part in select.of if isinstance(part, Not)
        ):  # "the car but not its shadow" is a car
            things = tuple(part for part in select.of if not isinstance(part, Not))
            yield from _certain(things[0]) if len(things) == 1 else (And(things),)
    elif isinstance(select, Or | And):
        for part in select.of:
            yield from _certain(part)
    elif isinstance(select, Not | Part):
        yield from _certain(select.of)
    elif isinstance(select, Beside):
        yield from _certain(select.other)


def _is_shadow(select: SelectKind) -> bool:
    """Return True if a selection is of words for shadows and the like alone."""
    parts = list(parts_of(select))
    return all(isinstance(part, Or | Text) for part in parts) and all(
        is_cast(label) for part in parts if isinstance(part, Text) for label in part.labels
    )


def _beside_in(select: SelectKind) -> Iterator[SelectKind]:
    """The things beside which something stands, in a selection."""
    if isinstance(select, Beside):
        yield select.other
    of = getattr(select, "of", ())
    for part in of if isinstance(of, tuple) else (of,):
        yield from _beside_in(part)


def which_of(operations: Sequence[Change], select: SelectKind, many: int, frame: int) -> Several:
    """The question which of `many` things of a kind is meant, with a command for each and one for all."""
    text = next(part for part in (select, *getattr(select, "of", ())) if isinstance(part, Text))
    noun = plural_of(singular(text.labels[0]))
    places = PLACES.get(many, MANY)
    meant: list[SelectKind] = [Instance(Text(text.labels), place, frame) for place in places]  # type: ignore[arg-type]
    commands = [_with(operations, text, one) for one in meant]
    every = f"{'both' if many == 2 else 'all the'} {noun}"
    commands.append([re.sub(rf"\bthe {re.escape(text.labels[0])}\b", every, line) for line in _lines(operations)])
    offered = tuple(re.sub(r" of frame \d+", "", "; ".join(lines)) for lines in commands)
    return Several(f"There are {many} {noun} in the scene, and it is not said which one is meant.", offered)


def _lines(operations: Sequence[Change]) -> list[str]:
    return [in_words([one]) for one in operations]


def _with(operations: Sequence[Change], text: Text, one: SelectKind) -> list[str]:
    """The operations in words, with another selection in place of a thing that is named."""

    def changed(value: Any) -> Any:
        if isinstance(value, Text) and text.labels[0] in value.single:
            others = tuple(label for label in value.labels if label != text.labels[0])
            return Or((one, replace(value, labels=others))) if others else one
        return None

    return _lines([mapped(operation, changed) for operation in operations])
