"""Selecting by a volume in space: which Gaussians lie in a box that is placed, turned and sheared as it may be."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import Scene

MOMENTS = 16
"""Clip times, evenly spaced, at which Gaussians that move are looked at."""


def inside_cube(scene: Scene, cube_from_scene: np.ndarray) -> np.ndarray:
    """Return the Gaussians (N,) bool whose centers are within the cube from -1 to 1, at any time of the clip.

    `cube_from_scene`: (4,4) affine matrix from the scene's axes to the cube's own.
    """
    moves = bool(scene.moving.any())
    inside = np.zeros(len(scene.ids), bool)
    for time in scene.cameras.times[evenly_spaced(len(scene.cameras), MOMENTS if moves else 1)]:
        means = scene.posed(float(time)).means.astype(np.float64)
        inside |= (np.abs(means @ cube_from_scene[:3, :3].T + cube_from_scene[:3, 3]) <= 1).all(1)
    return inside
