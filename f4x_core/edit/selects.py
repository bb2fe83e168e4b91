"""Selections, the targets of operations, as plain data. `resolve` of the planning step turns every kind into `Ids`.

Only `Ids`, `All`, `Moving`, `Named` and their combinations are found in a stack: they mean the same whenever it is replayed.
The others ask the scene (words, prompts, "the left one") and are answered once, when an edit is planned.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, Union

import numpy as np

from ..errors import F4xError
from .records import Record

FEW = 32
"""So many ids are written as a list; more are packed."""
MAX_WORDS_LENGTH = 200
"""Letters kept of what a selection was called."""


class Select(Record):
    """Base of the kinds of selections."""

    KEY = "by"


@dataclass(frozen=True)
class All(Select):
    """Every Gaussian."""

    TAG = "all"


@dataclass(frozen=True)
class Moving(Select):
    """The Gaussians that are carried by the scaffold."""

    TAG = "moving"


@dataclass(frozen=True)
class Heading(Select):
    """The moving things that go one way across the picture: "the man walking to the left"."""

    TAG = "heading"
    way: Literal["left", "right"]
    """As the clip's camera sees it."""


@dataclass(frozen=True)
class Current(Select):
    """The caller's current selection: "it", "this", "the selection"."""

    TAG = "current"


@dataclass(frozen=True)
class Named(Select):
    """A selection that an earlier `name` operation of the stack stored."""

    TAG = "named"
    name: str
    """As it was given."""


@dataclass(frozen=True)
class Ids(Select):
    """Gaussians by id: a list, or packed. Make it with `Ids.of`; equal sets are equal records."""

    TAG = "ids"
    ids: tuple[int, ...] = ()
    """In increasing order."""
    first: int = 0
    """Id of the first bit of `packed`."""
    packed: str = ""
    """Base64 of one bit per id from `first` on, the highest bit of a byte first."""
    words: str = field(default="", compare=False)
    """Their name when they were looked up, for people: "the left dog of frame 5"."""

    def __post_init__(self) -> None:
        """Refuse what cannot be read."""
        if self.ids and self.packed:
            raise F4xError("ids and packed exclude one another; give one.")
        if any(i < 0 or i >= 1 << 63 for i in (*self.ids, self.first)):
            raise F4xError("an id is negative or no 64-bit number; give ids of the scene.")
        if len(self.words) > MAX_WORDS_LENGTH or not self.words.isprintable():
            raise F4xError(f"words is no short line; give at most {MAX_WORDS_LENGTH} letters.")
        try:
            base64.b64decode(self.packed, validate=True)
        except (binascii.Error, ValueError) as error:
            raise F4xError("packed is no base64; write the selection anew.") from error

    @classmethod
    def of(cls, ids: np.ndarray) -> Ids:
        """Return the selection of `ids (n,)` in any order; doubles are dropped."""
        ids = np.unique(np.asarray(ids, np.int64))
        if len(ids) <= FEW or (ids[-1] - ids[0]) > 64 * len(ids):  # so thinly spread that the list is shorter
            return cls(ids=tuple(ids.tolist()))
        first = int(ids[0])
        bits = np.zeros(int(ids[-1]) - first + 1, bool)
        bits[ids - first] = True
        return cls(first=first, packed=base64.b64encode(np.packbits(bits).tobytes()).decode())

    @property
    def array(self) -> np.ndarray:
        """(n,) int64 ids in increasing order."""
        if not self.packed:
            return np.unique(np.array(self.ids, np.int64))
        bits = np.unpackbits(np.frombuffer(base64.b64decode(self.packed), np.uint8))
        return np.flatnonzero(bits) + self.first


@dataclass(frozen=True)
class Text(Select):
    """Gaussians that words mean, by the scene's feature field (`query.prompts.select_by_text`)."""

    TAG = "text"
    labels: tuple[str, ...]
    """Words that are looked for; any of them."""
    negatives: tuple[str, ...] | None = None
    """Words that they are weighed against; None = the usual surroundings."""
    threshold: float = 0.5
    """Least probability, 0 to 1."""
    number: Literal["any", "one", "both"] = "any"
    """`one`: said in the singular, which leaves copies out where anybody else answers; `both`: there must be two or more."""
    count: int = 0
    """So many of them are said, of no certain ones, so that there must be just as many; 0: not said."""
    single: tuple[str, ...] = field(default=(), compare=False)
    """Those of the labels that were said in the singular: of several that are there one is meant, and nobody knows which."""

    def __post_init__(self) -> None:
        """Validate."""
        if not self.labels:
            raise F4xError("labels is empty; give at least one word.")
        if not 0 <= self.threshold <= 1:
            raise F4xError(f"threshold is {self.threshold:g}; give a fraction from 0 to 1.")

    def to_json(self) -> dict[str, Any]:
        """Return plain values without `single`, which only matters while a sentence is planned."""
        return {name: value for name, value in super().to_json().items() if name != "single"}


@dataclass(frozen=True)
class Point(Select):
    """The thing at a pixel of a clip frame."""

    TAG = "point"
    frame: int
    """Clip frame."""
    x: float
    """Pixels from the left edge."""
    y: float
    """Pixels from the upper edge."""


@dataclass(frozen=True)
class Box(Select):
    """The thing in a box of a clip frame."""

    TAG = "box"
    frame: int
    """Clip frame."""
    box: tuple[float, float, float, float]
    """Left, top, right, bottom in pixels."""


@dataclass(frozen=True)
class Instance(Select):
    """One of several separate things of a kind: "the left one", "the biggest car"."""

    TAG = "instance"
    of: SelectKind
    """The kind."""
    which: Literal[
        "left", "right", "top", "bottom", "middle", "nearest", "farthest", "largest", "smallest",
        "top left", "top right", "bottom left", "bottom right",
    ]  # fmt: skip
    """Its place among several, seen through the clip's camera at `frame`."""
    frame: int = 0
    """Clip frame."""


@dataclass(frozen=True)
class Part(Select):
    """A part of a thing by place: "the upper half of the dog"."""

    TAG = "part"
    of: SelectKind
    """The thing."""
    side: Literal["top", "bottom", "left", "right"]
    """Its part of the picture, seen through the clip's camera at `frame`."""
    share: float = 0.5
    """Fraction of its height or width."""
    frame: int = 0
    """Clip frame."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 0 < self.share <= 1:
            raise F4xError(f"share is {self.share:g}; give a fraction from 0 to 1.")


SHARES = {"half": 0.5, "third": 0.333, "quarter": 0.25, "two thirds": 0.667, "part|portion|side|section": 0.5}
"""Words for the fraction of a thing that a part is -> the fraction."""
COPY = "copy"
"""The name by which "the copy" is selected after "copy the dog"."""
Where = Literal["near", "left", "right", "above", "below", "behind", "front"]
"""Places of a thing beside another, in the picture and in depth."""


@dataclass(frozen=True)
class Beside(Select):
    """Those of a kind that stand so to another thing: "the lamp next to the bed", "the crowd behind the dancer"."""

    TAG = "beside"
    of: SelectKind
    """The kind."""
    where: Where
    """Seen through the clip's camera at `frame`."""
    other: SelectKind
    """To whom."""
    each: bool = False
    """All that stand so; else the one of them that is nearest to the other."""
    frame: int = 0
    """Clip frame."""


@dataclass(frozen=True)
class And(Select):
    """Intersection of selections."""

    TAG = "and"
    of: tuple[SelectKind, ...]
    """At least one."""


@dataclass(frozen=True)
class Or(Select):
    """Union of selections."""

    TAG = "or"
    of: tuple[SelectKind, ...]
    """At least one."""


@dataclass(frozen=True)
class Not(Select):
    """Everything else."""

    TAG = "not"
    of: SelectKind
    """Selection that is left out."""


SelectKind = Union[All, Moving, Heading, Current, Named, Ids, Text, Point, Box, Instance, Part, Beside, And, Or, Not]  # noqa: UP007  # forward references
"""Any selection."""


def parts_of(select: SelectKind) -> Iterator[SelectKind]:
    """Yield a selection and everything it is made of."""
    yield select
    of = getattr(select, "of", ())
    for part in (*(of if isinstance(of, tuple) else (of,)), *((select.other,) if isinstance(select, Beside) else ())):
        yield from parts_of(part)
