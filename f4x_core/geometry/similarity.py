"""Points that were moved: the similarities that moved them, in groups that went as one. Needs numpy alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from . import pose, quaternion

ROUNDING = 5e-6
"""Residual up to which points count as moved by one similarity, relative to the largest coordinate: float32 arithmetic of a
program that moved them."""
MIN_POINTS = 3
"""Points that determine a rotation."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """x' = pivot + scale R (x - pivot) + translation."""

    translation: np.ndarray
    """(3,)"""
    rotation: np.ndarray
    """(4,) unit wxyz of R."""
    scale: float
    pivot: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) point about which it turns and scales; of fitted ones the mean of the points before."""

    @property
    def rotation_degrees(self) -> np.ndarray:
        """(3,) axis times angle in degrees."""
        return np.rad2deg(quaternion.to_rotation_vector(self.rotation))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Move `points (n,3)`."""
        around = quaternion.rotate(self.rotation, points - self.pivot)
        return self.pivot + self.scale * around + self.translation


def fit_similarity(before: np.ndarray, after: np.ndarray) -> Similarity | None:
    """Return the similarity, or translation if enough, that moves `before (n,3)` to `after (n,3)` up to rounding; else None."""
    before, after = np.asarray(before, np.float64), np.asarray(after, np.float64)
    tolerance = ROUNDING * max(1.0, np.abs(before).max(initial=0), np.abs(after).max(initial=0))
    pivot, translation = before.mean(0), (after - before).mean(0)
    candidates = [Similarity(translation, np.array([1.0, 0.0, 0.0, 0.0]), 1.0, pivot)]
    if len(before) >= MIN_POINTS:
        scale, rotation, _ = pose.align_similarity(before, after)
        candidates.append(Similarity(translation, quaternion.from_matrix(rotation), float(scale), pivot))
    return next((each for each in candidates if np.abs(each(before) - after).max() <= tolerance), None)


def split_by_motion(
    before: np.ndarray, after: np.ndarray, max_groups: int
) -> tuple[list[tuple[np.ndarray, Similarity]], np.ndarray]:
    """Split moved points into groups that each moved as one.

    `before`, `after`: (n,3). Returns (rows (m,), similarity) for one group of all points where one similarity moved them, else
    for at most `max_groups` groups of equal translation, largest first; and the rows that are in no group.
    """
    if not len(before):
        return [], np.zeros(0, np.int64)
    whole = fit_similarity(before, after)
    if whole is not None:
        return [(np.arange(len(before)), whole)], np.zeros(0, np.int64)
    way = after.astype(np.float64) - before
    step = 2 * ROUNDING * max(1.0, float(np.abs(after).max()))
    _, group, count = np.unique(np.rint(way / step), axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)  # numpy 2.0 gives it another shape
    found, left = [], np.ones(len(before), bool)
    for number in np.argsort(-count, kind="stable")[:max_groups]:
        rows = np.flatnonzero(group == number)
        motion = fit_similarity(before[rows], after[rows])
        if motion is not None:
            found.append((rows, motion))
            left[rows] = False
    return found, np.flatnonzero(left)
