"""Placement and appearance of Gaussians, and similarities that move them: the values that operations work on."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from ..geometry import quaternion

MAX_COORDINATE = 1e12
"""Maximum distance and size in world units, so that repeated scaling stays within float32."""
BASE_PERCENTILE = 98
"""The base of an object is this percentile of its heights, so that stray Gaussians below it do not count."""


class Placement(NamedTuple):
    """Geometry of n Gaussians: where they are and how large."""

    means: np.ndarray
    """(n,3) float32 world."""
    quats: np.ndarray
    """(n,4) float32 wxyz, unit."""
    scales: np.ndarray
    """(n,3) float32."""
    presence: np.ndarray
    """(n,) float32 presence at the time that is shown, 0 to 1."""
    tint: np.ndarray
    """(n,3) float32 tint at the time that is shown; (n,0) where colors stay."""


class Appearance(NamedTuple):
    """Appearance of n Gaussians."""

    opacities: np.ndarray
    """(n,) float32 in [0, 1]."""
    sh: np.ndarray
    """(n,S,3) float32."""

    def with_opacities(self, chosen: np.ndarray, opacities: np.ndarray | np.float32) -> Appearance:
        """Return the appearance with other opacities where `chosen (n,) bool`."""
        return self._replace(opacities=np.where(chosen, opacities, self.opacities))


class Motion(NamedTuple):
    """A similarity: x' = pivot + scale R (x - pivot) + translate."""

    rotation: np.ndarray
    """(4,) wxyz."""
    scale: float
    pivot: np.ndarray
    """(3,) world."""
    translate: np.ndarray
    """(3,) world."""

    @property
    def shift(self) -> np.ndarray:
        """(3,) image of the origin: x' = scale R x + shift."""
        return self.pivot + self.translate - self.scale * quaternion.rotate(self.rotation, self.pivot)

    def after(self, other: Motion) -> Motion:
        """Return the composition: `other` first, then this motion."""
        shift = self.scale * quaternion.rotate(self.rotation, other.shift) + self.shift
        rotation = quaternion.multiply(self.rotation, other.rotation)
        return Motion(rotation, self.scale * other.scale, np.zeros(3), shift)

    def __call__(self, placed: Placement) -> Placement:
        """Return the Gaussians moved; values that do not change keep their bits."""
        turns, resizes = self.rotation[1:].any(), self.scale != 1
        if not (turns or resizes or self.translate.any()):
            return placed
        means, quats, scales, presence, tint = placed.means.astype(np.float64), *placed[1:]
        if turns or resizes:
            means = self.pivot + self.scale * quaternion.rotate(self.rotation, means - self.pivot)
        if turns:
            quats = quaternion.normalize(quaternion.multiply(self.rotation, quats)).astype(np.float32)
        if resizes:
            scales = np.minimum(scales * self.scale, MAX_COORDINATE).astype(np.float32)
        means = np.clip(means + self.translate, -MAX_COORDINATE, MAX_COORDINATE).astype(np.float32)
        return Placement(means, quats, scales, presence, tint)


NO_MOTION = Motion(quaternion.IDENTITY, 1.0, np.zeros(3), np.zeros(3))
State = TypeVar("State", Placement, Appearance)


def put(state: State, where: np.ndarray, values: State) -> State:
    """`state` with the rows `where (n,) bool` replaced by `values`."""
    if where.all():
        return values
    parts = []
    for old, new in zip(state, values, strict=True):
        parts.append(old.copy())
        parts[-1][where] = new
    return type(state)(*parts)


def pivot_of(kind: str, means: np.ndarray) -> np.ndarray:
    """Return the `centroid` (3,) float64 (median) of `means (n,3)`, or its `base`: the lowest middle (y points down)."""
    pivot = np.median(means, axis=0).astype(np.float64)
    if kind == "base":
        pivot[1] = np.percentile(means[:, 1], BASE_PERCENTILE)
    return pivot
