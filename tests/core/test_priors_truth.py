"""Priors from rendered truth without any files: visibility, chained motion and seeds against loops over pixels."""

from itertools import pairwise

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig, TracksConfig
from f4x_core.priors import synthetic as module
from f4x_core.priors.synthetic import Truth
from f4x_core.progress import silent

FRAMES, HEIGHT, WIDTH = 5, 20, 28


def truth(seed=0):
    """A camera that steps aside and ahead before a slanted wall with a hole to the sky, and a square that moves in the picture."""
    rng = np.random.default_rng(seed)
    matrices = np.tile(np.eye(4), (FRAMES, 1, 1))
    matrices[:, 0, 3], matrices[:, 2, 3] = -0.12 * np.arange(FRAMES), 0.05 * np.arange(FRAMES)
    lens = np.tile(np.array([[25.0, 0, 14], [0, 25, 10], [0, 0, 1]]), (FRAMES, 1, 1))
    cameras = CameraPath(lens, matrices, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    depth = np.tile(np.linspace(2, 3, WIDTH), (FRAMES, HEIGHT, 1)) * np.exp(
        0.02 * rng.standard_normal((FRAMES, HEIGHT, WIDTH))
    )
    depth[:, 2:5, 20:24] = np.nan
    moving = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    forward, backward = rng.normal(0, 0.1, (2, FRAMES, HEIGHT, WIDTH, 2))
    for t in range(FRAMES):
        moving[t, 6 + t : 13 + t, 5 + 2 * t : 13 + 2 * t] = True
        forward[t][moving[t]] = [2.0, 1.0] + 0.15 * rng.standard_normal((moving[t].sum(), 2))
        backward[t][moving[t]] = [-2.0, -1.0] + 0.15 * rng.standard_normal((moving[t].sum(), 2))
    depth[moving] = 1.2
    parts = (one.astype(np.float32) for one in (depth, forward, backward))
    return Truth(cameras, *parts, moving)


def pixel(uv):
    u, v = (0 if not np.isfinite(one) else one for one in uv)
    inside = bool(0 <= uv[0] < WIDTH and 0 <= uv[1] < HEIGHT)
    return int(min(max(u, 0), WIDTH - 1)), int(min(max(v, 0), HEIGHT - 1)), inside


PLACES = np.array(
    [[0, 0], [27.9, 19.9], [28, 3], [3, 20], [-0.1, 3], [3, -0.1], [np.nan, 3], [5, np.inf], [-np.inf, 2], [13.4, 7.7]]
)


def test_pixels_under_places():
    x, y, inside = module._pixels_of(PLACES, (HEIGHT, WIDTH))
    for n, place in enumerate(PLACES):
        assert (x[n], y[n], inside[n]) == pixel(place)


def test_background_is_far_and_static_points_are_reprojected():
    known = truth()
    assert known.far == pytest.approx(1e4 * np.nanmedian(known.depth))
    uv, depth = np.array([[3.2, 4.5], [20.5, 3.5]]), np.array([2.2, np.nan])
    found, z = known.reproject(1, 3, uv, depth)
    points = known.cameras[1].unproject(uv, np.array([2.2, known.far]))
    expected, away = known.cameras[3].project(points)
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(z, away)


def shown(known, frame, uv, depth):
    x, y, inside = pixel(uv)
    here = known.depth[frame]
    seen = here[y, x] if np.isfinite(here[y, x]) else known.far
    below, right = (abs(here[min(y + a, HEIGHT - 1), min(x + b, WIDTH - 1)] - here[y, x]) for a, b in ((1, 0), (0, 1)))
    step = below + right
    slack = 0.02 * seen + min(0 if np.isnan(step) else step, 0.1 * seen)
    close = abs(seen - depth) < slack or (seen >= known.far / 2 and depth >= known.far / 2)
    return inside and close and depth > 0 and not known.moving[frame, y, x]


def test_what_is_the_visible_surface():
    known, rng = truth(), np.random.default_rng(1)
    known.depth[2, 14:19, 2:8] = 0.6  # nearer than the unit
    uv = rng.uniform([-2, -2], [WIDTH + 2, HEIGHT + 2], (600, 2))
    uv[:100] = rng.uniform([20, 2], [24, 5], (100, 2))
    depth = rng.uniform(1.9, 3.2, 600)
    depth[:50], depth[50:60], depth[100:110] = known.far * rng.uniform(0.3, 2, 50), -1, -2.5
    near = np.arange(150, 400)
    for n in near:  # about what is there
        x, y, _ = pixel(uv[n])
        depth[n] = np.nan_to_num(known.depth[2, y, x], nan=known.far) * rng.uniform(0.85, 1.15)
    found = known.shows(2, uv, depth)
    expected = [shown(known, 2, one, z) for one, z in zip(uv, depth, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert 0.1 < found.mean() < 0.9


def vector(known, flow, frame, uv):
    x, y, _ = pixel(uv)
    corner = np.clip(uv - 0.5, 0, [WIDTH - 1, HEIGHT - 1])
    c, r = min(int(corner[0]), WIDTH - 2), min(int(corner[1]), HEIGHT - 2)
    u, v = corner - (c, r)
    weights = np.array([[(1 - u) * (1 - v), u * (1 - v)], [(1 - u) * v, u * v]])
    if (weights * known.moving[frame, r : r + 2, c : c + 2]).sum() > 0.999:
        return (weights[..., None] * flow[frame, r : r + 2, c : c + 2]).sum((0, 1))
    return flow[frame, y, x]


@pytest.mark.parametrize(("source", "target"), [(0, 3), (4, 1), (2, 3), (2, 2)])
def test_moving_points_are_chained(source, target):
    known, rng = truth(), np.random.default_rng(2)
    uv = rng.uniform([4, 5], [14, 14], (80, 2)) + source * np.array([2.0, 1.0])
    found, alive = known.follow(source, target, uv)
    sign = 1 if target > source else -1
    for n, place in enumerate(uv):
        lives = True
        for frame in range(source, target, sign):
            there, back = (known.forward, known.backward) if sign > 0 else (known.backward, known.forward)
            moved = place + vector(known, there, frame, place)
            x, y, inside = pixel(moved)
            returned = moved + vector(known, back, frame + sign, moved)
            lives = lives and inside and known.moving[frame + sign, y, x] and np.linalg.norm(returned - place) < 0.5
            place = moved
        np.testing.assert_allclose(found[n], place, atol=1e-5)
        assert alive[n] == lives
    assert source == target or 0.1 < alive.mean() < 0.95


def test_seeds_lie_where_no_track_does():
    known, rng = truth(), np.random.default_rng(3)
    tracks, visible = rng.uniform([-3, -3], [WIDTH + 3, HEIGHT + 3], (20, 2)), rng.random(20) < 0.5
    for spacing in (1.0, 3.0, 4.7, 0.2):
        for moving in (False, True):
            step = max(int(spacing), 1)
            expected = []
            for y in range(step // 2, HEIGHT, step):
                for x in range(step // 2, WIDTH, step):
                    cells = [
                        (int(u) // step, int(v) // step) for (u, v), seen in zip(tracks, visible, strict=True) if seen
                    ]
                    if (
                        known.moving[1, y, x] == moving
                        and np.isfinite(known.depth[1, y, x])
                        and (x // step, y // step) not in cells
                    ):
                        expected.append((x + 0.5, y + 0.5))
            found = module._seeds(known, 1, moving, spacing, [(tracks, visible)])
            np.testing.assert_array_equal(found, np.array(expected).reshape(-1, 2))


@pytest.mark.parametrize("moving", [False, True])
def test_seeds_are_tracked_both_ways(moving):
    known, frames = truth(), np.array([0, 1, 3, 4])
    seeds = module._seeds(known, 3, moving, 2.0, [])
    tracks, visible = module._tracked(known, frames, 2, seeds, moving)
    np.testing.assert_array_equal(tracks[2], seeds)
    assert visible[2].all() and 0.2 < visible.mean() < 1
    if not moving:
        depth = np.array([known.depth[3, int(v), int(u)] for u, v in seeds])
        for i, frame in enumerate(frames):
            if i != 2:
                uv, z = known.reproject(3, frame, seeds, depth)
                np.testing.assert_allclose(tracks[i], np.where((z > 0)[:, None], uv, np.nan))
                np.testing.assert_array_equal(visible[i], known.shows(frame, uv, z))
        return
    for order in ((2, 3), (2, 1, 0)):
        for before, i in pairwise(order):
            for n in range(len(seeds)):
                if not visible[before, n]:
                    assert not visible[i, n] and np.isnan(tracks[i, n]).all()
                    continue
                (uv,), (held,) = known.follow(frames[before], frames[i], tracks[before, n][None])
                assert visible[i, n] == held
                np.testing.assert_allclose(tracks[i, n], uv if held else np.nan)


def test_points_behind_a_camera_have_no_place():
    known = truth()
    known.cameras.world_to_camera[4, 2, 3] = -5.0  # it walked through the wall
    seeds = module._seeds(known, 0, False, 5.0, [])
    tracks, visible = module._tracked(known, np.arange(5), 0, seeds, False)
    assert np.isnan(tracks[4]).all() and not visible[4].any()


def given(held_out=(2,), **tracks):
    known = truth()
    pictures = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    clip = Clip("toy", pictures, np.arange(float(FRAMES)), 24.0, np.isin(np.arange(FRAMES), held_out), "toy")
    priors = Priors.empty(clip)
    priors.scratch.of_providers["truth"] = known
    return known, clip, priors, PriorsConfig(tracks=TracksConfig(**tracks))


def test_flow_and_masks_follow_the_truth():
    known, clip, priors, config = given()
    reports = []
    module.provide_flow(clip, priors, config, lambda *all: reports.append(all))
    grid = known.cameras[0].pixel_grid()
    for name, order in (("forward", [(0, 1), (1, 3), (3, 4)]), ("backward", [(1, 0), (3, 1), (4, 3)])):
        for i, (source, target) in enumerate(order):
            flow, mask = getattr(priors, f"flow_{name}")[i], getattr(priors, f"flow_{name}_mask")[i]
            uv, z = known.reproject(source, target, grid.reshape(-1, 2), known.depth[source].ravel())
            seen = known.shows(target, uv, z)
            moving = known.moving[source].ravel()
            uv[moving], seen[moving] = known.follow(source, target, grid.reshape(-1, 2)[moving])
            np.testing.assert_array_equal(flow, (uv.reshape(grid.shape) - grid).astype(np.float16))
            np.testing.assert_array_equal(mask.ravel(), seen)
    assert [report[1] for report in reports] == [0, 1, 2, 3] * 2 and {report[2] for report in reports} == {3}
    known.cameras.world_to_camera[1, 2, 3] = -known.depth[0, 0, 0] + 1e-7  # beyond what half floats hold
    module.provide_flow(clip, priors, config, silent)
    assert np.isfinite(priors.flow_forward).all() and abs(priors.flow_forward).max() <= 6e4


@pytest.mark.parametrize(("every", "count"), [(2, 1000), (3, 25), (0, 1000)])
def test_tracks_are_seeded_again_and_the_longest_kept(every, count):
    known, clip, priors, config = given(reseed_every=every, count=count, spacing=5.0, dynamic_spacing=3.0)
    module.provide_tracks(clip, priors, config, silent)
    frames, found = np.array([0, 1, 3, 4]), []
    for start in range(0, 4, max(every, 1)):
        for moving, spacing in ((False, 5.0), (True, 3.0)):
            seeds = module._seeds(known, frames[start], moving, spacing, [(t[start], v[start]) for t, v in found])
            if len(seeds):
                found.append(module._tracked(known, frames, start, seeds, moving))
    tracks, visible = (np.concatenate([one[k] for one in found], 1) for k in (0, 1))
    keep = sorted(
        sorted(range(tracks.shape[1]), key=lambda n: (-visible[:, n].sum(), n * (5**0.5 - 1) / 2 % 1))[:count]
    )
    np.testing.assert_array_equal(priors.tracks, tracks[:, keep].astype(np.float32))
    np.testing.assert_array_equal(priors.tracks_visible, visible[:, keep])
    module.provide_motion(clip, priors, config, silent)
    np.testing.assert_array_equal(priors.mask, known.moving[frames])
    np.testing.assert_array_equal(priors.motion, known.moving[frames])
    for n in range(len(keep)):
        hits = [
            known.moving[f, pixel(priors.tracks[i, n])[1], pixel(priors.tracks[i, n])[0]]
            for i, f in enumerate(frames)
            if priors.tracks_visible[i, n]
        ]
        assert priors.tracks_motion[n] == (np.mean(hits) > 0.5)


def test_a_track_moves_when_most_of_it_does():
    mask = np.zeros((4, 6, 8), bool)
    mask[:, 2, 3] = True
    tracks = np.full((4, 3, 2), 0.5)
    tracks[:2, 0], tracks[:3, 1], tracks[:, 2] = [3.5, 2.5], [3.5, 2.5], [3.5, 2.5]
    visible = np.ones((4, 3), bool)
    visible[:, 2] = False
    np.testing.assert_array_equal(module.motion_of_tracks(tracks, visible, mask), [0, 1, 0])


def test_cameras_and_depth_are_in_median_depths():
    known, clip, priors, config = given()
    module.provide_cameras(clip, priors, config, silent)
    module.provide_depth(clip, priors, config, silent)
    frames = [0, 1, 3, 4]
    unit = np.nanmedian(known.depth[frames])
    np.testing.assert_allclose(priors.cameras.centers, known.cameras.centers[frames] / unit)
    assert priors.camera_kind == "moving" and (priors.depth_confidence == 1).all()
    expected = np.where(np.isfinite(known.depth[frames]), known.depth[frames] / unit, module.MAX_DEPTH)
    np.testing.assert_allclose(priors.depth, expected, rtol=1e-6)
