"""Shadows of meshes on Gaussians, as a factor: how much of the light of lamps still reaches each centre.

A fitted Gaussian has its own light in its colour, and no surface on which more could fall. So lamps of the scene only take light
away where a mesh stands in their way. Shadows are hard but for the size of the lamp. What casts rays is the caller's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .exposure import GOLDEN_ANGLE

STRENGTH = 0.7
"""Fraction of the light that lamps take away where none of them reaches: the rest is the sky's."""
SAMPLES = 16
"""Points of a lamp with a size that are looked at from each Gaussian."""
BLOCK = 1 << 16
"""Points that are worked on together: with all their ways about 100 MB."""
OFF = 1e-4
"""Fraction of the way to a lamp, or of the size of what casts shadows for the sun, before which nothing casts one: a Gaussian that
lies on a mesh does not hide itself."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """A sun or a ball of light."""

    power: float
    """Of a sun its irradiance, W/m^2; of a ball its W."""
    size: float
    """Of a sun the tangent of half its angle, of a ball its radius in world units; 0 has hard shadows."""
    place: np.ndarray | None = None
    """(3,) centre of a ball in the world; None for a sun."""
    towards: np.ndarray | None = None
    """(3,) unit vector to a sun; None for a ball."""

    def irradiance(self, points: np.ndarray) -> np.ndarray:
        """(N,) W/m^2 at `points (N,3)` on what faces the lamp."""
        if self.place is None:
            return np.full(len(points), self.power)
        squared = ((points - self.place) ** 2).sum(1)
        return self.power / (4 * np.pi * np.maximum(squared, max(self.size, OFF) ** 2))

    def ways(self, points: np.ndarray, reach: float) -> np.ndarray:
        """(N,S,3) ways from `points (N,3)` to S points on the disc that the lamp shows them; to a sun `reach` far."""
        count = SAMPLES if self.size > 0 else 1
        radius, angle = np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * GOLDEN_ANGLE
        disc = self.size * radius * np.array([np.cos(angle), np.sin(angle)]) * (self.size > 0)
        if self.place is not None:
            middle = self.place - points
        else:
            assert self.towards is not None
            middle, disc = np.broadcast_to(reach * self.towards, points.shape), reach * disc
        side = np.cross(middle, np.eye(3)[np.abs(middle).argmin(axis=1)])
        side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), np.finfo(float).tiny)
        up = np.cross(middle, side)
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), np.finfo(float).tiny)
        return middle[:, None] + disc[0][:, None] * side[:, None] + disc[1][:, None] * up[:, None]


@dataclass(frozen=True, eq=False)
class Caster:
    """Something that casts shadows."""

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
        share = lamp.irradiance(points)
        whole += share
        for first in range(0, len(points), BLOCK):
            block = slice(first, first + BLOCK)
            seen[block] += share[block] * _visible(points[block], lamp.ways(points[block], reach), casters)
    lost = 1 - np.where(whole > 0, seen / np.where(whole > 0, whole, 1), 1)
    return np.where(lost > 0, 1 - strength * lost, 1.0)


def _visible(points: np.ndarray, ways: np.ndarray, casters: Sequence[Caster]) -> np.ndarray:
    """(N,) fraction of the `ways (N,S,3)` from `points (N,3)` on which nothing stands."""
    free = np.ones(ways.shape[:2], bool)
    for caster in casters:
        row, sample = np.nonzero(free & _meets(points, ways, caster.box))
        if len(row):
            way = ways[row, sample]
            free[row, sample] = ~caster.blocks(points[row] + OFF * way, (1 - OFF) * way)
    return free.mean(1)


def _meets(points: np.ndarray, ways: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(N,S) bool: whether a way passes through a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (box[:, None, None] - points[:, None]) / ways  # (2,N,S,3)
    # a way along a side of the box has no number there, and does not leave it
    enter = np.where(np.isnan(ends), -np.inf, ends).min(0)
    leave = np.where(np.isnan(ends), np.inf, ends).max(0)
    return np.maximum(enter.max(2), 0) <= np.minimum(leave.min(2), 1)
