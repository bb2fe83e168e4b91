"""Operations in plain English, for histories, dry runs and panels; where the language has it, as `language.parse` reads it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..language.colour_names import Colour, name_of
from ..language.lexicon import PLACES, plural, singular
from .change import DIRECTIONS, Change, ChangeWithShadow, Vector
from .selects import (
    COPY,
    SHARES,
    All,
    And,
    Beside,
    Box,
    Current,
    Heading,
    Ids,
    Instance,
    Moving,
    Named,
    Not,
    Or,
    Part,
    Point,
    SelectKind,
    Text,
)

_WHICH = {"largest": "biggest"}
_AXES = (("to the left", "to the right"), ("up", "down"), ("forward", "back"))
"""Along the camera's axes: what a negative and a positive step is called."""
SCENE_AXES = "the scene's own axes"


def describe(operation: Change) -> str:
    """Return one line, for example "make the dog red from frame 20 on"."""
    return operation.described()


def describe_in(operation: Change, to_world: np.ndarray, axes: str) -> str:
    """Return `describe` with shifts and rotations along the axes of another world, called `axes`, in place of the scene's.

    `to_world (3,3)`: rotation and scale from the scene to that world.
    """
    turn = to_world / np.maximum(np.linalg.norm(to_world, axis=0), 1e-12)

    def along(matrix: np.ndarray, vector: Vector) -> Vector:
        x, y, z = (float(value) for value in matrix @ np.array(vector))
        return x, y, z

    return operation.in_axes(partial(along, to_world), partial(along, turn)).described().replace(SCENE_AXES, axes)


def in_words(operations: Sequence[Change]) -> str:
    """Return a plan in the words of the language."""
    return "; ".join(map(describe, operations))


_PLACE_WORDS = {
    "near": "next to",
    "left": "to the left of",
    "right": "to the right of",
    "above": "above",
    "below": "below",
    "behind": "behind",
    "front": "in front of",
}


def beside_words(way: Vector) -> str:
    """Return the place of a thing beside another in words."""
    return next(_PLACE_WORDS[where] for where, direction in DIRECTIONS.items() if direction == way)


def whom_with(operation: ChangeWithShadow) -> str:
    """Return the selection of an operation in words, with what goes along: "the car with its shadow"."""
    along, who = operation.along, whom(operation.select)
    if not (isinstance(along, Ids) and along.words):
        return who
    return f"{who} with {_THEIRS.get(along.words, along.words) if are_several(who) else along.words}"


_THEIRS = {"its shadow": "their shadows", "its edges": "their edges"}


def are_several(who: str) -> bool:
    """Return True if a selection in words is in the plural: "the 2 dogs"."""
    first, *words = who.partition(" of frame")[0].split()
    plural_noun = bool(words) and (words[0].isdigit() or singular(words[-1]) != words[-1])
    return first in ("the", "both") and (" and " in who or plural_noun)


def whom(select: SelectKind) -> str:
    """Return a selection in words."""
    if isinstance(select, Text):
        return " and ".join(f"the {label}" for label in select.labels)
    if isinstance(select, Instance):
        kind = whom(select.of).removeprefix("the ")
        if isinstance(select.of, All | Moving | Or):
            kinds = {All: "thing", Moving: "moving thing"}
            kind = kinds.get(type(select.of)) or f"one of {whom(select.of)}"
        return f"the {_WHICH.get(select.which, select.which)} {kind} of frame {select.frame}"
    if isinstance(select, Part):
        side = {"top": "upper", "bottom": "lower"}.get(select.side, select.side)
        share = next((name for name, x in SHARES.items() if x == select.share), "part")
        return f"the {side} {share} of {whom(select.of)}"
    if isinstance(select, Beside):
        return f"{whom(select.of)} {_PLACE_WORDS[select.where]} {whom(select.other)}"
    if isinstance(select, Heading):
        return f"what goes to the {select.way}"
    if isinstance(select, Point):
        return f"the thing at {select.x:g}, {select.y:g} in frame {select.frame}"
    if isinstance(select, Box):
        return f"the thing in the box {number_words(select.box)} of frame {select.frame}"
    if isinstance(select, Or):
        return " and ".join(map(whom, select.of))
    if isinstance(select, And):
        return _both(select)
    if isinstance(select, Not):
        return "the background" if isinstance(select.of, Moving) else f"everything except {whom(select.of)}"
    if isinstance(select, Named):
        return f"the {select.name}" if select.name.split()[0] == COPY else select.name
    if isinstance(select, Ids):
        return select.words or f"{len(select.array)} Gaussians"
    return {All: "everything", Moving: "what moves", Current: "the selection"}[type(select)]


def _both(select: And) -> str:
    background = Not(Moving())
    kept = [whom(part) for part in select.of if not isinstance(part, Not) or part == background]
    left_out = [whom(part.of) for part in select.of if isinstance(part, Not) and part != background]
    if len(kept) == 2 and isinstance(select.of[1], Moving):
        kept = [f"the moving {kept[0].removeprefix('the ')}"]
    also = [
        f" that {part.removeprefix('what ') if part.startswith('what ') else f'is also {part}'}" for part in kept[1:]
    ]
    return "".join([*(kept[:1] or ["everything"]), *also]) + "".join(f" but not {part}" for part in left_out)


def span_words(frames: tuple[float, float | None] | None, open_end: str = "on") -> str:
    """Return the span of an operation in words: " from frame 5 to frame 20"; empty for all times."""
    if frames is None:
        return ""
    start, end = frames
    return f" from frame {start:g} " + (open_end if end is None else f"to frame {end:g}")


def colour_words(rgb: Colour) -> str:
    """Return a color as its name, hexadecimal digits or numbers."""
    bytes_ = [round(255 * c) for c in rgb]
    exact = tuple(round(byte / 255, PLACES) for byte in bytes_) == tuple(round(c, PLACES) for c in rgb)
    return name_of(rgb) or ("#" + "".join(f"{byte:02x}" for byte in bytes_) if exact else f"rgb {number_words(rgb)}")


def times_words(factor: float, plain: str, more: str, less: str) -> str:
    """Return a factor in words: "twice as bright", "20 % darker"."""
    if factor in (2, 0.5):
        return f"{'twice' if factor == 2 else 'half'} as {plain}"
    return f"{percent_words(factor - 1)} {more}" if factor >= 1 else f"{percent_words(1 - factor)} {less}"


def percent_words(fraction: float) -> str:
    """Return a fraction in percent."""
    return f"{round(100 * fraction, PLACES):g} %"


def strength_words(share: float) -> str:
    """Return a strength in percent, to stand before an adjective; empty for 1."""
    return "" if share == 1 else f"{percent_words(share)} "


def number_words(values: tuple[float, ...]) -> str:
    """Return numbers with commas between them."""
    return ", ".join(f"{value:g}" for value in values)


def rounded_words(values: tuple[float, ...]) -> str:
    """Return numbers to three digits; less than a hundredth of the largest is 0."""
    largest = max(map(abs, values))
    return ", ".join(f"{value:.3g}" if abs(value) >= largest / 100 else "0" for value in values)


def way_words(vector: Vector, unit: str, axes: str) -> str:
    """Return a shift in widths along the camera's axes, or in numbers along the scene's."""
    measure = {"world": "unit", "size": "width", "pixels": "pixel", "pictures": "picture"}[unit]
    if axes == "world":
        return f"by ({rounded_words(vector)}) {measure}s along {SCENE_AXES}"
    return " and ".join(f"by {step}" for step in _steps(vector, measure))


def _steps(vector: Vector, measure: str) -> list[str]:
    steps = [(abs(x), _AXES[axis][x > 0]) for axis, x in enumerate(vector) if x]
    return [f"{far:g} {plural(measure, far)} {way}" for far, way in steps]


def steps_in_words(vector: Vector) -> str:
    """Return a shift in widths along the camera's axes: "1.1 widths to the left and 0.2 widths up"."""
    return " and ".join(_steps(vector, "width"))
