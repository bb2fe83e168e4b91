"""What a fit is supervised with: frames that may be seen, at two resolutions, and tracks of what surely moves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from toy import clip_and_priors

from f4x_core.fit.frame_data import FrameData, MovingTracks, Window
from f4x_core.fit.loss_terms import Rendered
from f4x_core.fit.losses import rgb_loss
from f4x_core.priors import Priors
from f4x_core.priors.sizes import LargeMaps


@pytest.mark.parametrize("hold_out", [0, 3])
def test_only_supervised_frames_are_looked_at(hold_out):
    clip, priors = clip_and_priors(7, hold_out=hold_out)
    full = FrameData.full(clip, priors)
    assert (full.width, full.height) == (64, 40)
    np.testing.assert_array_equal(full.rgb, clip.frames[[0, 1, 3, 4, 6] if hold_out else slice(None)])
    for frame in range(len(priors.frames)):
        np.testing.assert_array_equal(full.maps(frame).depth, priors.depth[frame])
        np.testing.assert_array_equal(full.maps(frame).motion, priors.motion[frame])
    assert np.shares_memory(full.rgb.numpy(), clip.frames) == (not hold_out), "all frames are not copied"


def test_half_the_resolution_averages_colours_and_samples_the_rest():
    rng = np.random.default_rng(1)
    rgb = torch.from_numpy(rng.integers(0, 256, (2, 5, 7, 3), np.uint8))
    maps = [rng.random((2, 5, 7)).astype(kind) for kind in (np.float32, np.float16, np.float16)]
    priors = Priors(7, 5, np.arange(2), depth=maps[0], depth_confidence=maps[1], motion=maps[2])
    half = FrameData(rgb, LargeMaps(priors, 7, 5), 7, 5).halved()
    assert (half.width, half.height) == (3, 2) and half.rgb.dtype == torch.uint8 and half.rgb.shape == (2, 2, 3, 3)
    for f in range(2):
        of_frame = half.maps(f)
        assert {tuple(each.shape) for each in (of_frame.depth, of_frame.confidence, of_frame.motion)} == {(2, 3)}
        for r in range(2):
            for c in range(3):
                for k in range(3):
                    four = rgb[f, 2 * r : 2 * r + 2, 2 * c : 2 * c + 2, k].double().numpy()
                    assert half.rgb[f, r, c, k] == round(float(four.mean()))
                for found, whole in zip((of_frame.depth, of_frame.confidence, of_frame.motion), maps, strict=True):
                    assert found[r, c] == whole[f, 2 * r, 2 * c]


def test_pictures_larger_than_the_priors_get_them_enlarged_at_either_resolution():
    clip, priors = clip_and_priors(3)
    frames = clip.frames.repeat(2, 1).repeat(2, 2)
    full = FrameData.full(replace(clip, frames=frames), priors)
    assert (full.width, full.height) == (128, 80)
    half = full.halved()
    for data in (full, half):
        large = LargeMaps(priors, data.width, data.height)
        np.testing.assert_array_equal(data.maps(1).depth, large.depth(1).depth)
        np.testing.assert_array_equal(data.maps(1).motion, large.motion(1))
    np.testing.assert_array_equal(half.maps(1).depth, priors.depth[1])


def test_what_nobody_saw_supervises_nothing():
    clip, priors = clip_and_priors(5)
    hidden = np.zeros(clip.frames.shape[:3], bool)
    hidden[:, :, 32:] = True
    full = FrameData.full(replace(clip, hidden=hidden), priors)
    maps = full.maps(0)
    assert maps.depth[:, 32:].isnan().all() and not maps.confidence[:, 32:].any()
    assert not maps.motion[:, 32:].any() and full.seen(0).mean() == 0.5
    assert full.halved().hidden[:, :, 16:].all() and not full.halved().hidden[:, :, :16].any()
    drawn = torch.rand(40, 64, 4, requires_grad=True)
    rendered = Rendered(full.target(2), SimpleNamespace(channels=drawn))
    loss = rgb_loss(rendered.rgb, rendered.target.float() / 255, torch.ones(40, 64), 0.2) + rendered.dynamic_alpha.sum()
    (gradient,) = torch.autograd.grad(loss, drawn)
    assert not gradient[:, 32:].any() and gradient[:, :32].abs().min(-1).values.mean() > 0
    assert (rendered.target[:, 32:].float() / 255 - drawn[:, 32:, :3]).abs().max() < 0.51 / 255
    np.testing.assert_array_equal(rendered.target[:, :32], clip.frames[2][:, :32])


def test_a_window_around_what_moves_stays_within_the_picture():
    region = torch.zeros(20, 30, dtype=torch.bool)
    assert Window.around(region, 3) is None
    region[2:5, 10:29] = True
    window = Window.around(region, 3)
    assert window == Window(7, 0, 23, 8)
    assert window.of(torch.arange(600).view(20, 30))[0, 0] == 7 and window.halved() == Window(3, 0, 11, 4)
    parts = [window.part(46, torch.Generator().manual_seed(seed)) for seed in range(40)]
    assert {(part.width, part.height) for part in parts} == {(11, 4)} and window.part(184, torch.Generator()) == window
    assert min(part.left for part in parts) == 7 and max(part.left + 11 for part in parts) == 30
    clip, priors = clip_and_priors(3)
    priors.motion = np.zeros_like(priors.motion)
    priors.motion[1, 10:20, 30:50] = 1
    full = FrameData.full(clip, priors)
    assert full.moving_windows == {1: Window(22, 2, 36, 26)}
    part = full.target(1).within(full.moving_windows[1])
    np.testing.assert_array_equal(part.rgb, clip.frames[1][2:28, 22:58])
    np.testing.assert_array_equal(part.priors.depth, priors.depth[1, 2:28, 22:58])
    hidden = np.ones((26, 36), bool)
    hidden[4:-4, 4:-4] = False
    np.testing.assert_array_equal(part.near_movers().hidden, hidden)


@pytest.fixture
def priors():
    """Priors of four frames with twenty tracks, random visibility, half of them surely moving."""
    _, priors = clip_and_priors(4)
    rng = np.random.default_rng(0)
    priors.tracks = rng.uniform(0, 40, (4, 20, 2)).astype(np.float32)
    priors.tracks_visible = rng.random((4, 20)) < 0.6
    priors.tracks_motion = np.where(np.arange(20) % 2, 0.51, 0.5).astype(np.float32)
    return priors


def test_two_frames_share_the_moving_tracks_that_both_see(priors):
    tracks = MovingTracks.of(priors)
    one, other = tracks.shared(1, 3)
    rows = [i for i in range(1, 20, 2) if priors.tracks_visible[1, i] and priors.tracks_visible[3, i]]
    assert 0 < len(rows) < 10
    np.testing.assert_array_equal(one, priors.tracks[1, rows])
    np.testing.assert_array_equal(other, priors.tracks[3, rows])
    assert (tracks.width, tracks.height) == (64, 40)


@pytest.mark.parametrize("missing", ["tracks", "tracks_visible", "tracks_motion"])
def test_without_tracks_that_surely_move_no_frame_has_a_partner(priors, missing):
    setattr(priors, missing, None)
    tracks = MovingTracks.of(priors)
    count = 0 if missing == "tracks" else 20
    assert tracks.points.shape == (4, count, 2) and tracks.visible.shape == (4, count)
    assert tracks.visible.dtype == torch.bool and not tracks.visible.any()
    assert tracks.random_partner(0, torch.Generator()) is None
