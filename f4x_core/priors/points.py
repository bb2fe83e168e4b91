"""The points in space that tracks show, if they stand still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import CameraPath
from .bundle import Observations, from_matrices, triangulate

TRACK_OUTLIER_PX = 2.0
"""A track whose root mean square reprojection error is larger is no static point."""


@dataclass(frozen=True)
class FittedPoints:
    """One point per track (n), and its sightings (O)."""

    frame: np.ndarray
    """(O,) int."""
    point: np.ndarray
    """(O,) int."""
    z: np.ndarray
    """(O,) depth in that frame."""
    rms: np.ndarray
    """(n,) pixels, root mean square reprojection error; infinite behind a camera that saw it, or where no frame did."""
    spread: np.ndarray
    """(n,) radians between the rays."""


def fit_points(cameras: CameraPath, tracks: np.ndarray, seen: np.ndarray) -> FittedPoints:
    """The points nearest to the rays of `tracks (F,n,2)` in pixels in the frames in which they are `seen (F,n)`."""
    count = tracks.shape[1]
    frame, point = np.nonzero(seen)
    # Given cameras may zoom: sightings are brought to one normalised camera first.
    intrinsics = cameras.intrinsics[frame]
    focal = intrinsics[:, [0, 1], [0, 1]]
    plane = (tracks[frame, point] - intrinsics[:, :2, 2]) / focal
    bundle = from_matrices(cameras.world_to_camera, 1.0, np.zeros(2))
    points, spread = triangulate(bundle, Observations(frame, point, plane, np.ones(len(frame))), count)
    local = np.einsum("oij,oj->oi", cameras.world_to_camera[frame, :3, :3], points[point])
    local += cameras.world_to_camera[frame, :3, 3]
    z = local[:, 2]
    error = ((local[:, :2] / np.maximum(z, 1e-9)[:, None] - plane) * focal) ** 2
    sightings = np.bincount(point, minlength=count)
    rms = np.sqrt(np.bincount(point, error.sum(1), count) / np.maximum(sightings, 1))
    known = (sightings > 0) & np.isfinite(rms) & (np.bincount(point, ~(z > 0), count) == 0)
    return FittedPoints(frame, point, z, np.where(known, rms, np.inf), spread)
