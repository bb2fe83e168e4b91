"""Camera paths by name: where a scene is seen from, picture after picture, and when a video shows them."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from ..errors import F4xError
from ..geometry import trajectory
from ..geometry.trajectory import Trajectory
from ..scene import Scene
from ..scene.posing import require_time

NUMBERED = {
    "frozen": "frozen:T with T a clip frame, for example frozen:12",
    "bullet": "bullet:T with T a clip frame, for example bullet:12",
    "slow": "slow:FACTOR, for example slow:4",
}
"""Paths with a number -> how to write them."""
MAX_SLOWER = 100
"""Slower than this is a still."""


@dataclass(frozen=True, eq=False)
class Film:
    """Views of a scene, and the times at which a video shows them."""

    views: Trajectory
    """Camera and clip time of every picture."""
    times: np.ndarray | None
    """Times of all pictures, as `write_video` takes them; None: evenly spaced."""

    @classmethod
    def along(cls, scene: Scene, path: str, degrees: float) -> Film:
        """Return the views of `trajectory_of`."""
        return cls(trajectory_of(scene, path, degrees), times_of(scene, path))


def trajectory_of(scene: Scene, path: str, degrees: float) -> Trajectory:
    """Return the views that `--path` names."""
    cameras = scene.cameras
    if path == "original":
        return trajectory.original(cameras)
    if path == "orbit":
        return trajectory.orbit(cameras, degrees=degrees)
    if path == "stabilise":
        return trajectory.stabilised(cameras)
    kind, colon, number = path.partition(":")
    if colon and kind in NUMBERED and not os.path.isfile(path):
        try:
            value = float(number)
        except ValueError as error:
            raise F4xError(f"--path {path}: write {NUMBERED[kind]}.") from error
        if kind in ("frozen", "bullet"):
            require_time(scene, value, f"--path {path}")
        if kind == "bullet":
            return trajectory.bullet_time(cameras, value, degrees)
        if kind == "slow":
            if not 1 <= value <= MAX_SLOWER:
                raise F4xError(f"--path {path}: give a factor from 1 to {MAX_SLOWER}.")
            return trajectory.slow_motion(cameras, value)
        return trajectory.frozen(cameras, value)
    if not os.path.isfile(path):
        raise F4xError(
            f"--path {path}: there is no such file; give original, orbit, stabilise, slow:FACTOR, bullet:T or frozen:T"
            f" with T a clip frame (0 to {len(cameras) - 1}), or a camera path file."
        )
    return trajectory.read_path(path)


def times_of(scene: Scene, path: str, indices: np.ndarray | None = None) -> np.ndarray | None:
    """Return the times at which a video shows the views of `--path`, or those at `indices`: `write_video`'s `times`.

    Those of the clip on its own path, if its frames are not evenly spaced; None otherwise.
    """
    if path != "original" or scene.cameras.steady:
        return None
    return scene.cameras.times if indices is None else scene.cameras.times[indices]
