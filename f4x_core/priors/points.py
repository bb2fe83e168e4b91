"""The points in space that tracks show, if they stand still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import CameraPath
from .bundle import Observations, from_matrices, triangulate

TRACK_OUTLIER_PX = 2.0
"""A track whose root mean square reprojection error is larger is no static point."""
SLIP_PX = 1.0
"""Reprojection error from which a sighting counts less in rounds of `fit_points` (the scale of Cauchy's weights)."""


@dataclass(frozen=True)
class FittedPoints:
    """One point per track (n), and its sightings (O)."""

    frame: np.ndarray
    """(O,) int."""
    point: np.ndarray
    """(O,) int."""
    z: np.ndarray
    """(O,) depth in that frame."""
    error: np.ndarray
    """(O,) pixels, reprojection error; infinite behind the camera."""
    rms: np.ndarray
    """(n,) pixels, root mean square reprojection error; infinite behind a camera that saw it, or where no frame did."""
    spread: np.ndarray
    """(n,) radians between the rays."""

    @property
    def inverse_depth(self) -> np.ndarray:
        """(n,) mean over the frames that saw it; 0 where none did."""
        count = np.bincount(self.point, minlength=len(self.rms))
        return np.bincount(self.point, 1 / np.maximum(self.z, 1e-9), len(self.rms)) / np.maximum(count, 1)

    def rms_of_nearest(self, fraction: float) -> np.ndarray:
        """Return (n,) pixels: as `rms`, of that fraction of each point's sightings that fits best."""
        order = np.lexsort((self.error, self.point))
        count = np.bincount(self.point, minlength=len(self.rms))
        rank = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
        kept = order[rank < np.ceil(fraction * np.repeat(count, count))]
        squares = np.bincount(self.point[kept], self.error[kept] ** 2, len(self.rms))
        number = np.bincount(self.point[kept], minlength=len(self.rms))
        return np.where(number > 0, np.sqrt(squares / np.maximum(number, 1)), np.inf)


def fit_points(cameras: CameraPath, tracks: np.ndarray, seen: np.ndarray, rounds: int = 0) -> FittedPoints:
    """Return the points nearest to the rays of `tracks (F,n,2)` in pixels in the frames in which they are `seen (F,n)`.

    In so many further `rounds` sightings that miss the point count less: tracks slip where something passes before them.
    """
    count = tracks.shape[1]
    frame, point = np.nonzero(seen)
    # Given cameras may zoom: sightings are brought to one normalised camera first.
    intrinsics = cameras.intrinsics[frame]
    focal = intrinsics[:, [0, 1], [0, 1]]
    plane = (tracks[frame, point] - intrinsics[:, :2, 2]) / focal
    bundle = from_matrices(cameras.world_to_camera, 1.0, np.zeros(2))
    weight = np.ones(len(frame))
    for left in range(rounds, -1, -1):
        points, spread = triangulate(bundle, Observations(frame, point, plane, weight), count)
        local = np.einsum("oij,oj->oi", cameras.world_to_camera[frame, :3, :3], points[point])
        local += cameras.world_to_camera[frame, :3, 3]
        z = local[:, 2]
        squares = (((local[:, :2] / np.maximum(z, 1e-9)[:, None] - plane) * focal) ** 2).sum(1)
        if left:
            weight = 1 / (1 + squares / SLIP_PX**2)
    squares = np.where((z > 0) & np.isfinite(squares), squares, np.inf)
    sightings = np.bincount(point, minlength=count)
    rms = np.sqrt(np.bincount(point, squares, count) / np.maximum(sightings, 1))
    return FittedPoints(frame, point, z, np.sqrt(squares), np.where(sightings > 0, rms, np.inf), spread)
