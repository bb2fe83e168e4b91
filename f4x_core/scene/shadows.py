"""Shadows of meshes on Gaussians: the fraction of the lamps' light that reaches each centre.

A fitted Gaussian has its own light in its colour, and no surface on which more could fall. So lamps of the scene only take light
away where a mesh stands in their way. Shadows are hard but for the size of the lamp. What casts rays is the caller's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .exposure import GOLDEN_ANGLE

STRENGTH = 0.7
"""Fraction of the light that lamps take away where none of them reaches: the rest is the sky's."""
SAMPLES = 16
"""Points of a lamp with a size that are looked at from each Gaussian."""
BLOCK = 1 << 16
"""Points that are worked on together: with all their ways about 100 MB."""
_TURNS = np.arange(SAMPLES) * GOLDEN_ANGLE
_DISC = np.sqrt((np.arange(SAMPLES) + 0.5) / SAMPLES)[:, None] * np.stack([np.cos(_TURNS), np.sin(_TURNS)], 1)
"""(S,2) spread evenly over a disc of radius 1."""
_SQUARE = (
    2 * np.stack([(np.arange(SAMPLES) + 0.5) / SAMPLES, (np.arange(SAMPLES) + 0.5) * GOLDEN_ANGLE / (2 * np.pi) % 1], 1)
    - 1
)
"""(S,2) spread evenly over a square of side 2."""
OFF = 1e-4
"""Fraction of the way to a lamp, or of the size of what casts shadows for the sun, before which nothing casts one: a Gaussian that
lies on a mesh does not hide itself."""


class Lamp(Protocol):
    """Light source."""

    def rays(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return ways (N,S,3) from `points (N,3)` to S places of the lamp, and the irradiance (N,S) by each of them, W/m^2.

        Irradiance is that of a surface that faces the lamp. The ways to a sun are `reach` long.
        """
        ...


@dataclass(frozen=True, eq=False)
class Sun:
    """Light from one direction."""

    power: float
    """Irradiance, W/m^2."""
    size: float
    """The tangent of half its angle; 0 has hard shadows."""
    towards: np.ndarray
    """(3,) unit vector to it."""

    def rays(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return `Lamp.rays`."""
        ways = _to_disc(np.broadcast_to(reach * self.towards, points.shape), reach * self.size)
        return ways, np.full(ways.shape[:2], self.power / ways.shape[1])


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball that shines in all directions."""

    power: float
    """W."""
    size: float
    """Radius in world units; 0 has hard shadows."""
    place: np.ndarray
    """(3,) its centre in the world."""

    def rays(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return `Lamp.rays`."""
        middle = self.place - points
        squared = np.maximum((middle**2).sum(1), max(self.size, OFF) ** 2)
        ways = _to_disc(middle, self.size)
        count = ways.shape[1]
        return ways, np.repeat((self.power / (4 * np.pi * count) / squared)[:, None], count, axis=1)


@dataclass(frozen=True, eq=False)
class Spot(Ball):
    """A ball whose light leaves in a cone."""

    to_lamp: np.ndarray
    """(3,3) world directions to the lamp's own axes; it shines along -z. Axes of a scaled lamp squeeze the cone."""
    cosine: float
    """Cosine of half the angle of the cone."""
    blend: float
    """Fraction of the cone, by cosine, over which its light ends; 0 has a hard edge."""

    def rays(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return `Lamp.rays`."""
        ways, given = super().rays(points, reach)
        own = (points - self.place) @ self.to_lamp.T
        along = -own[:, 2] / np.maximum(np.linalg.norm(own, axis=1), np.finfo(float).tiny)
        edge = np.clip((along - self.cosine) / max((1 - self.cosine) * self.blend, np.finfo(float).eps), 0, 1)
        return ways, given * (edge**2 * (3 - 2 * edge))[:, None]


@dataclass(frozen=True, eq=False)
class Area:
    """A flat lamp that shines to one side."""

    power: float
    """W."""
    place: np.ndarray
    """(3,) its middle in the world."""
    sides: np.ndarray
    """(2,3) from the middle to the middle of a side and of the next one, or half the axes of an ellipse."""
    towards: np.ndarray
    """(3,) unit vector of the direction in which it shines."""
    is_round: bool = False
    """An ellipse, not a rectangle."""
    spread: float = np.pi
    """Angle within which its light leaves, rad."""

    def rays(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Lamp`; every place of it counts by its distance and by how obliquely it is seen."""
        places = self.place + (_DISC if self.is_round else _SQUARE) @ self.sides
        ways = places - points[:, None]
        squared = np.maximum((ways**2).sum(2), OFF**2)
        cosine = np.maximum(-(ways @ self.towards), 0) / np.sqrt(squared)
        given = self.power / (np.pi * SAMPLES) * cosine / squared
        if self.spread < np.pi:  # a honeycomb before it
            half = self.spread / 2
            with np.errstate(divide="ignore"):
                tangent = np.sqrt(np.maximum(1 / cosine**2 - 1, 0))
            given = given * np.maximum(np.tan(half) - tangent, 0) / (np.tan(half) - half)
        return ways, given


def _to_disc(middle: np.ndarray, size: float) -> np.ndarray:
    """Return (N,S,3) ways to S points on a disc of radius `size` across the ways `middle (N,3)`; one way without a size."""
    if size <= 0:
        return middle[:, None]
    side = np.cross(middle, np.eye(3)[np.abs(middle).argmin(axis=1)])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), np.finfo(float).tiny)
    up = np.cross(middle, side)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), np.finfo(float).tiny)
    return middle[:, None] + size * (_DISC[:, :1] * side[:, None] + _DISC[:, 1:] * up[:, None])


@dataclass(frozen=True, eq=False)
class Caster:
    """Object that casts shadows."""

    box: np.ndarray
    """(2,3) its smallest and largest coordinates in the world."""
    blocks: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """(starts (R,3), ways (R,3)) -> (R,) bool: whether it stands between a start and the end of its way."""


def light_left(
    points: np.ndarray, lamps: Sequence[Lamp], casters: Sequence[Caster], strength: float = STRENGTH
) -> np.ndarray:
    """Return (N,) the fraction of its light that each of `points (N,3)` keeps: 1 where no lamp is hidden from it.

    Each lamp counts by its irradiance at the point; `strength` is what is lost where all are hidden.
    """
    if not (len(points) and lamps and casters):
        return np.ones(len(points))
    everything = np.concatenate([points, *(caster.box for caster in casters)])
    reach = float(np.linalg.norm(np.ptp(everything, axis=0)))
    whole, seen = np.zeros(len(points)), np.zeros(len(points))
    for lamp in lamps:
        for first in range(0, len(points), BLOCK):
            block = slice(first, first + BLOCK)
            ways, given = lamp.rays(points[block], reach)
            whole[block] += given.sum(1)
            seen[block] += np.where(_free(points[block], ways, given > 0, casters), given, 0).sum(1)
    lost = 1 - np.where(whole > 0, seen / np.where(whole > 0, whole, 1), 1)
    return np.where(lost > 0, 1 - strength * lost, 1.0)


def _free(points: np.ndarray, ways: np.ndarray, asked: np.ndarray, casters: Sequence[Caster]) -> np.ndarray:
    """Return (N,S) bool: `ways (N,S,3)` from `points (N,3)` that meet no triangle; only those of `asked (N,S)` are tested."""
    free = asked.copy()
    for caster in casters:
        row, sample = np.nonzero(free & _meets(points, ways, caster.box))
        if len(row):
            way = ways[row, sample]
            free[row, sample] = ~caster.blocks(points[row] + OFF * way, (1 - OFF) * way)
    return free


def _meets(points: np.ndarray, ways: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return (N,S) bool: whether a way passes through a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (box[:, None, None] - points[:, None]) / ways  # (2,N,S,3)
    # a way along a side of the box has no number there, and does not leave it
    enter = np.where(np.isnan(ends), -np.inf, ends).min(0)
    leave = np.where(np.isnan(ends), np.inf, ends).max(0)
    return np.maximum(enter.max(2), 0) <= np.minimum(leave.min(2), 1)
