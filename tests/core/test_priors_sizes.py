"""Priors of large pictures, made from smaller ones."""

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.clip.images import resize_linear, resize_nearest
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig, build_priors
from f4x_core.priors.sizes import LargeMaps, moving_masks, shrunk

FRAMES, WIDTH, HEIGHT = 3, 96, 64


def cameras(width=WIDTH, height=HEIGHT):
    lens = np.tile(np.array([[80.0, 0, width / 2], [0, 80.0, height / 2], [0, 0, 1]]), (FRAMES, 1, 1))
    return CameraPath(lens, np.tile(np.eye(4), (FRAMES, 1, 1)), np.arange(FRAMES, dtype=float), width, height)


def large_clip(**more):
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    return Clip("toy", frames, np.arange(FRAMES, dtype=float), 24.0, np.zeros(FRAMES, bool), "toy.mp4", **more)


def test_a_small_clip_stays_itself():
    clip = large_clip()
    assert shrunk(clip, WIDTH) is clip


@pytest.mark.parametrize("portrait", [False, True])
def test_the_longer_side_is_reduced_and_what_belongs_to_it_follows(portrait):
    clip = large_clip(cameras=cameras(), masks=np.zeros((FRAMES, HEIGHT, WIDTH), bool))
    if portrait:
        clip = large_clip()
        clip = Clip("toy", clip.frames.transpose(0, 2, 1, 3), clip.times, 24.0, clip.held_out, "toy.mp4")
    small = shrunk(clip, 48)
    assert (small.width, small.height) == ((32, 48) if portrait else (48, 32))
    if not portrait:
        assert small.masks.shape == (FRAMES, 32, 48)
        np.testing.assert_allclose(small.cameras.intrinsics[0, 0], [40, 0, 24])
    np.testing.assert_allclose(small.frames.mean(), clip.frames.mean(), atol=0.5)


def priors_of_a_box():
    """A moving box at depth 1 before a wall at depth 4, sure and unsure."""
    priors = Priors(WIDTH, HEIGHT, np.arange(FRAMES), camera_kind="moving", cameras=cameras())
    priors.mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    priors.mask[:, 16:32, 32:64] = True
    priors.depth = np.where(priors.mask, 1, 4).astype(np.float32)
    priors.depth_confidence = np.where(priors.mask, 0.2, 0.9).astype(np.float16)
    priors.motion = priors.mask.astype(np.float16)
    priors.tracks = np.full((FRAMES, 2, 2), [[10.0, 20.0], [40.0, 30.0]], np.float32)
    priors.tracks_visible = np.ones((FRAMES, 2), bool)
    priors.tracks_motion = np.array([0.0, 1.0], np.float32)
    return priors


def test_depths_do_not_mix_along_an_outline():
    large = LargeMaps(priors_of_a_box(), 3 * WIDTH, 3 * HEIGHT)
    found, mask = large.depth(1), large.mask(1)
    np.testing.assert_allclose(found.depth, np.where(mask, 1, 4), rtol=1e-5)
    np.testing.assert_allclose(found.confidence, np.where(mask, 0.2, 0.9), rtol=2e-3)
    assert abs(mask.mean() / priors_of_a_box().mask.mean() - 1) < 0.02


def test_maps_of_the_size_of_the_pictures_are_returned_as_they_are():
    priors = priors_of_a_box()
    same = LargeMaps(priors, WIDTH, HEIGHT)
    assert np.shares_memory(same.mask(1), priors.mask) and np.shares_memory(same.motion(1), priors.motion)
    assert np.shares_memory(same.depth(1).depth, priors.depth)
    assert np.shares_memory(same.depth(1).confidence, priors.depth_confidence)
    priors.depth_confidence = None
    assert (same.depth(1).confidence == 1).all()


def test_masks_of_what_moves_are_named_by_the_frames_of_the_clip():
    priors = priors_of_a_box()
    priors.frames = np.array([0, 2, 5])
    masks = moving_masks(priors, 2 * WIDTH, 2 * HEIGHT)
    assert [*masks] == [0, 2, 5] and masks[5].shape == (2 * HEIGHT, 2 * WIDTH) and masks[5].dtype == bool
    priors.mask = None
    assert moving_masks(priors, WIDTH, HEIGHT) is None


def test_unknown_depth_stays_unknown():
    priors = priors_of_a_box()
    priors.depth[:, :, :8] = np.nan
    found = LargeMaps(priors, 2 * WIDTH, 2 * HEIGHT).depth(0)
    assert np.isnan(found.depth[:, :15]).all() and np.isfinite(found.depth[:, 17:]).all()
    assert (found.confidence[np.isnan(found.depth)] == 0).all()
    np.testing.assert_array_equal(found.known, np.isfinite(found.depth))


def test_the_priors_of_large_pictures_are_small(tmp_path):
    depth, mask = np.ones((FRAMES, HEIGHT, WIDTH), np.float32), np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    for name, value in (("depth", depth), ("mask", mask)):
        np.save(tmp_path / f"{name}.npy", value)
    cameras().write(tmp_path / "cameras.json")
    given = {name: str(tmp_path / name) for name in ("depth.npy", "mask.npy", "cameras.json")}
    config = PriorsConfig(files={name.split(".")[0]: path for name, path in given.items()}, longer_side=48)
    priors = build_priors(large_clip(), tmp_path / "priors", config)
    assert (priors.width, priors.height) == (priors.cameras.width, priors.cameras.height) == (48, 32)
    assert priors.depth.shape == Priors.read(tmp_path / "priors").depth.shape == (FRAMES, 32, 48)
    again = build_priors(large_clip(), tmp_path / "priors", config)  # read, not made
    np.testing.assert_array_equal(priors.depth, again.depth)
    np.testing.assert_array_equal(priors.tracks, again.tracks)


def test_priors_do_not_depend_on_the_number_of_threads(tmp_path):
    found = [build_priors(large_clip(), tmp_path / str(threads), PriorsConfig(threads=threads)) for threads in (1, 3)]
    for name in ("flow_forward", "tracks", "motion", "mask", "depth", "depth_confidence"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


@pytest.mark.parametrize(("side", "size"), [(96, (96, 64)), (95, (94, 62)), (50, (50, 34)), (48, (48, 32))])
def test_sizes_are_even_and_keep_their_shape(side, size):
    depth = np.random.default_rng(0).uniform(1, 2, (FRAMES, HEIGHT, WIDTH)).astype(np.float32)
    clip = large_clip(depth=depth, masks=depth > 1.5)
    small = shrunk(clip, side)
    assert (small.width, small.height) == pytest.approx(size, abs=2)
    assert small.width % 2 == small.height % 2 == 0 and max(small.width, small.height) <= side + 1
    np.testing.assert_array_equal(small.depth, resize_nearest(depth, small.width, small.height))
    np.testing.assert_array_equal(small.masks, resize_nearest(clip.masks, small.width, small.height))


def uneven_priors():
    """Priors whose depth, confidence and mask vary from pixel to pixel, with holes."""
    rng = np.random.default_rng(0)
    priors = priors_of_a_box()
    priors.depth = rng.uniform(1, 4, priors.depth.shape).astype(np.float32)
    priors.depth[rng.random(priors.depth.shape) < 0.2] = np.nan
    priors.depth_confidence = rng.uniform(0, 1, priors.depth.shape).astype(np.float16)
    priors.motion = rng.uniform(0, 1, priors.depth.shape).astype(np.float16)
    return priors


@pytest.mark.parametrize("without", [(), ("mask",), ("depth_confidence",)])
def test_depth_is_enlarged_layer_by_layer(without):
    priors, width, height = uneven_priors(), 2 * WIDTH, 2 * HEIGHT
    for name in without:
        setattr(priors, name, None)
    large = LargeMaps(priors, width, height)
    for f in range(FRAMES):
        found = large.depth(f)
        mask = np.zeros((HEIGHT, WIDTH), bool) if priors.mask is None else priors.mask[f]
        inside = resize_linear(mask, width, height) > 0.5
        known = np.isfinite(priors.depth[f])
        inverse = np.where(known, 1 / priors.depth[f], 0)
        trust = np.ones((HEIGHT, WIDTH)) if priors.depth_confidence is None else priors.depth_confidence[f]
        for layer, there in ((~mask, ~inside), (mask, inside)):
            part, whole = (resize_linear(one, width, height) for one in (layer & known, layer))
            held = there & (part >= 0.5 * whole) & (whole > 1e-3)
            total = resize_linear(layer * inverse, width, height)
            np.testing.assert_allclose(found.depth[held], (part / total)[held], rtol=1e-4)
            sure = resize_linear(layer * known * trust, width, height)
            np.testing.assert_allclose(found.confidence[held], (sure / part)[held], atol=1e-3)
            lost = there & (part < 0.499 * whole)
            assert np.isnan(found.depth[lost]).all()
        np.testing.assert_allclose(large.motion(f), resize_linear(priors.motion[f], width, height), atol=1e-3)
