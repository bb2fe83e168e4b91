"""Amounts of changes as values: degrees, factors, distances and ways. Needs no grammar."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Literal, NamedTuple

from .refusal import Mismatch, Refusal

Vector = tuple[float, float, float]


class Degree(NamedTuple):
    """Amounts that each degree stands for, by kind of change."""

    factors: tuple[float, float]
    """Up and down."""
    opacity: tuple[float, float]
    """As `factors`, of how opaque something is."""
    share: float
    """Of the usual strength of a color, a light or a blur."""
    widths: float
    """A distance, in one of its units."""
    angle: float
    """Degrees that it turns."""


DEGREES: Mapping[str, Degree] = {
    "least": Degree((1.1, 0.91), (1.1, 0.9), 0.25, 0.15, 10.0),
    "small": Degree((1.2, 0.83), (1.25, 0.8), 0.5, 0.3, 15.0),
    "usual": Degree((1.5, 0.67), (2.0, 0.5), 1.0, 1.0, 90.0),
    "large": Degree((2.0, 0.5), (5.0, 0.2), 2.0, 2.0, 120.0),
    "most": Degree((2.5, 0.4), (10.0, 0.1), 3.0, 3.0, 150.0),
}
"""A tiny bit, a little, what is meant where no degree is said, much, a lot: each more than the one before."""


class Amount(NamedTuple):
    """An amount of a change."""

    kind: str
    """One of `DEGREES`; `times` or a `fraction` more; so many `stops` of light; `as`: so many times as much; `to` a value."""
    value: float = 1.0
    """Of the last five."""


def degree_of(how: Amount | None) -> Degree | None:
    """Return the amount that a degree stands for, the usual one without any; None for measured amounts."""
    return DEGREES.get(how.kind if how else "usual")


def factor(
    how: Amount | None, upward: bool, of: Callable[[Degree], tuple[float, float]] = attrgetter("factors")
) -> float:
    """Return the factor of a quality that grows (`upward`) or shrinks by an amount; Mismatch where it would not be positive.

    `of`: what a degree comes to, up and down.
    """
    if how is None or how.kind in DEGREES:
        return of(DEGREES[how.kind if how else "usual"])[not upward]
    if how.kind == "stops":
        return 2.0 ** (how.value if upward else -how.value)
    if how.kind == "fraction":
        return 1 + how.value if upward else 1 - how.value
    if upward or (how.kind == "times" and 0 < how.value < 1):  # "half smaller" is "half as big"
        return how.value
    if how.value <= 0:
        raise Mismatch
    return 1 / how.value


Unit = Literal["world", "size", "pixels", "pictures"]


class Distance(NamedTuple):
    """A distance in `unit`."""

    value: float
    unit: Unit = "size"


Steps = tuple[tuple[Distance | None, tuple[int, int, int], Distance | None], ...]
"""(distance before, direction, distance behind) of each step of a way."""


def displacement(way: Steps, far: Distance | None, default: float) -> tuple[Vector, Unit]:
    """Return (the sum of steps along the camera's axes, its unit); a step without a distance goes the last one's, else `far`."""
    shared = way[-1][2] or far or Distance(default)
    vector, units = [0.0, 0.0, 0.0], set()
    for before, signs, behind in way:
        one = before or behind or shared
        units.add(one.unit)
        for axis, step in enumerate(signs):
            if step and vector[axis] * step > 0:  # "back, away from the camera" is one way said twice
                continue
            if step and vector[axis]:
                raise Refusal("Two of the directions are on one line; say one of them.")
            vector[axis] += step * one.value
    if len(units) > 1:
        raise Refusal("Distances are in different units; use one of them.")
    return (vector[0], vector[1], vector[2]), units.pop()
