"""Real clips, small and short: the whole way from pictures to a measured scene, and a frozen world that needs no scaffold."""

import dataclasses

import pytest

from f4x_core.clip import read_clip, write_images
from f4x_core.evaluation.evaluate import Figures, evaluate
from f4x_core.fit.config import profile
from f4x_core.fit.pipeline import fit_clip
from f4x_core.geometry import trajectory
from f4x_core.scene.view import render

pytestmark = [pytest.mark.real, pytest.mark.slow]
SHORT = dataclasses.replace(profile("quick"), steps=400)


@pytest.fixture(scope="module")
def train(shared, tmp_path_factory):
    """A fitted stretch of `train`: (clip, scene)."""
    clip = read_clip(shared / "clips" / "train", frames="0:20", width=240, hold_out=8)
    return clip, fit_clip(clip, tmp_path_factory.mktemp("train"), SHORT).scene


def test_a_moving_clip_is_rebuilt_and_its_held_out_frames_are_foreseen(train):
    clip, scene = train
    scores = evaluate(scene, clip, Figures(baselines=True))
    assert len(scene.dynamic) > 0 and scene.scaffold is not None
    assert scores["used_psnr"] > 26
    assert scores["held_out_psnr"] > scores["held_out_psnr_nearest"] + 2


def test_a_frozen_world_needs_no_scaffold_and_no_dynamic_set(train, tmp_path):
    _, scene = train
    views = trajectory.frozen(scene.cameras, 10.0)
    frames = [render(scene, view.camera, view.time)["rgb"] for view in views]
    write_images(tmp_path / "frozen", frames)
    still = read_clip(tmp_path / "frozen")
    result = fit_clip(still, tmp_path / "fit", dataclasses.replace(SHORT, steps=100))
    scene = result.scene
    assert len(scene.dynamic) == 0 and scene.scaffold is None
    assert len(scene.static) > 0
    assert any("none" in need["chosen"] for need in scene.needs)
