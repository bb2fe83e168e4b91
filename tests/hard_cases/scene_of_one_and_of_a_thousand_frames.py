"""Scenes of one and of a thousand frames.

Hard: a scaffold with one time, and one with a thousand; asked for at, between and far outside of them.

Why: interpolation wants neighbours, and what is kept for every frame grows.

Must hold: poses are finite everywhere, and outside the clip the motion comes to rest.
"""

import numpy as np

from benchmarks.studies.hard_cases import that, within
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet

STAGE = "scene"


def scene_of(frames: int) -> Scene:
    """Five Gaussians on three nodes that turn and glide for so many frames."""
    times, rng = np.arange(frames, dtype=float), np.random.default_rng(0)
    angle = 0.05 * times
    quat = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], -1)[:, None].repeat(3, 1)
    xyz = rng.normal(size=(3, 3)) + 0.001 * times[:, None, None]
    scaffold = Scaffold(
        times,
        xyz.astype(np.float32),
        quat.astype(np.float32),
        np.full(3, 0.5, np.float32),
        np.ones((frames, 3), bool),
        np.arange(3),
        np.tile(np.arange(3), (3, 1)),
        np.ones((3, 3), bool),
        0.5,
    )
    dynamic = DynamicSet(
        ids=np.arange(5),
        means=rng.normal(size=(5, 3)).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (5, 1)),
        scales=np.full((5, 3), 0.1, np.float32),
        opacities=np.full(5, 0.9, np.float32),
        sh=np.zeros((5, 1, 3), np.float32),
        reference=np.full(5, frames // 2, np.int32),
        node=np.tile(np.int32([0, 1, 2]), (5, 1)),
        weight=np.full((5, 3), 1 / 3, np.float32),
        strength=np.ones(5, np.float32),
    )
    path = CameraPath(
        np.tile(np.diag([60.0, 60, 1]), (frames, 1, 1)), np.tile(np.eye(4), (frames, 1, 1)), times, 64, 40
    )
    return Scene("frames", StaticSet.empty(), path, dynamic, scaffold, 24.0)


def check():
    for frames in (1, 2, 1000):
        scene = scene_of(frames)
        for time in (-1e6, -0.5, 0.0, frames / 2, frames - 1.0, frames + 0.5, 1e6):
            yield that(f"{frames} frames, time {time:g}: finite", np.isfinite(scene.posed(time).means).all())
        late = [scene.posed(frames + after).means for after in (1e4, 1e6)]
        yield within(f"{frames} frames: at rest in the end", abs(late[0] - late[1]).max(), 1e-5)
        there = scene.posed(float(frames // 2)).means
        yield within(f"{frames} frames: in place at its reference", abs(there - scene.dynamic.means).max(), 1e-5)
