"""Tracks without depth, outside the picture, or unknown.

Hard: NaN and negative depths, NaN tracks, tracks that run out of the picture, all in one clip.

Why: an unknown depth lifted as a number puts a point at, or behind, the camera.

Must hold: only what is known is certain; curves are finite at every frame; no usable track is refused in words.
"""

import numpy as np

from benchmarks.studies.hard_cases import refused, that
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold.lifting import lift_tracks
from f4x_core.scaffold.selection import choose_nodes

STAGE = "scaffold"


def check():
    times, rng = np.arange(8.0), np.random.default_rng(0)
    lens = np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]])
    cameras = CameraPath(np.tile(lens, (8, 1, 1)), np.tile(np.eye(4), (8, 1, 1)), times, 64, 40)
    tracks = np.tile(rng.uniform((2, 2), (62, 38), (30, 2)), (8, 1, 1))
    depth = np.ones((8, 40, 64), np.float32)
    depth[:, :, :20], depth[:, :, 20:30] = np.nan, -1
    tracks[3, :5], tracks[4:, 5:8] = np.nan, (90, -3)
    visible = np.ones((8, 30), bool)
    lifted = lift_tracks(tracks, visible, depth, cameras, times)
    started = tracks[0, lifted.index, 0]
    yield that("something is lifted, all of it finite", len(lifted) > 0 and np.isfinite(lifted.xyz).all())
    yield that("nothing where depth is unknown", (started > 30 - 3).all())  # it may take a pixel two columns away
    unknown = lift_tracks(tracks, visible, np.full_like(depth, np.nan), cameras, times)
    yield refused(
        "no depth at all", "no track moves visibly with known depth", lambda: choose_nodes(unknown, times, 0.1)
    )
