"""The windows of a long clip are one way round: cameras of a later one are decided by the scene of the one before."""

import dataclasses

import numpy as np
import pytest
from test_priors_cameras import FOCAL, HEIGHT, WIDTH, clip_and_priors, project
from test_priors_mirror import ceiling

from f4x_core.fit.config import profile
from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import Scene, StaticSet
from f4x_core.windows.previous_window import PreviousWindow, WindowFit

pytestmark = pytest.mark.usefixtures("one_thread")


class CamerasAreFoundError(Exception):
    """Ends a fit before its depth."""


def test_a_window_keeps_the_way_round_of_the_one_before(tmp_path):
    """A ceiling is taken for a ground, near and far exchanged, unless the scene of the window before is asked; what was found
    without it is not gone on with."""
    true = ceiling(travel=0.03)
    clip, priors = clip_and_priors(*project(true, noise=0.6))  # errors alone no longer decide
    frames, size = len(clip.frames), (HEIGHT, WIDTH)
    priors.flow_forward, priors.flow_backward = np.zeros((2, frames - 1, *size, 2), np.float16)
    priors.flow_forward_mask, priors.flow_backward_mask = np.ones((2, frames - 1, *size), bool)
    priors.mask, priors.motion = np.zeros((frames, *size), bool), np.zeros((frames, *size), np.float16)
    given = [name for name in vars(priors) if name.startswith(("flow_", "mask", "motion", "tracks"))]
    (tmp_path / "priors").mkdir()
    for name in given:
        np.save(tmp_path / "priors" / f"{name}.npy", getattr(priors, name))

    count = len(true.points)
    distance = np.linalg.norm(true.points, axis=1, keepdims=True)
    static = StaticSet(
        ids=np.arange(count),
        means=true.points.astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        scales=np.repeat(np.float32(0.02 * distance), 3, 1),
        opacities=np.full(count, 0.99, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )
    path = true.path(np.arange(frames, dtype=float), WIDTH, HEIGHT)
    scene = Scene("before", static, path)

    def stop(stage, done, total, message=""):
        if (stage, message) == ("priors", "depth"):
            raise CamerasAreFoundError

    cameras = dataclasses.replace(profile("quick").priors.cameras, focal=FOCAL / WIDTH)
    config = dataclasses.replace(profile("quick"), threads=1)
    config = dataclasses.replace(config, priors=dataclasses.replace(config.priors, cameras=cameras))
    for first, right in ((frames, False), (0, True)):  # shares no frame, shares all
        with pytest.raises(CamerasAreFoundError):
            WindowFit(clip, tmp_path, config, stop, previous=PreviousWindow(scene, first, 0)).run()
        found = CameraPath.read(tmp_path / "priors" / "cameras.json").centers
        step, straight = found[-1] - found[0], true.rotation[0] @ (true.center[-1] - true.center[0])
        agreement = step @ straight / np.linalg.norm(step) / np.linalg.norm(straight)
        assert agreement > 0.8 if right else agreement < -0.8
