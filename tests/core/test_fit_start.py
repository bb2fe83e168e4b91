"""The start of a fit: which tracks move, how nodes were seen, and that depth of what moves goes with its nodes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import toy

from f4x_core.fit import start
from f4x_core.fit.config import profile
from f4x_core.fit.start import carried_depth, moving_tracks, start_scaffold
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors
from f4x_core.progress import silent
from f4x_core.scaffold import Scaffold

FRAMES, WIDTH, HEIGHT, FOCAL = 2, 60, 40, 50.0


def upright(xyz: np.ndarray, certain: np.ndarray) -> Scaffold:
    """Nodes at `xyz (F,M,3)` that do not turn and know no neighbours."""
    count = xyz.shape[1]
    return Scaffold(
        np.arange(float(FRAMES)),
        xyz,
        np.tile(np.array([1, 0, 0, 0], np.float32), (FRAMES, count, 1)),
        np.full(count, 0.5, np.float32),
        certain,
        np.arange(count),
        np.zeros((count, 1), np.int64),
        np.zeros((count, 1), bool),
        0.5,
    )


def case():
    """Priors of a region at depth 4 before one at 8, and nodes on the first."""
    intrinsics = np.tile(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]), (FRAMES, 1, 1))
    priors = Priors(WIDTH, HEIGHT, np.arange(FRAMES))
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    priors.cameras = CameraPath(intrinsics, poses, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    priors.mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    priors.mask[:, 10:30, 10:50] = True
    priors.depth = np.where(priors.mask, 4.0, 8.0).astype(np.float32)
    pixels = np.stack(np.meshgrid([12.0, 30.0, 48.0], [12.0, 28.0]), -1).reshape(-1, 2)
    xyz = np.column_stack([(pixels - [WIDTH / 2, HEIGHT / 2]) / FOCAL * 4, np.full(6, 4.0)])
    xyz = np.tile(xyz, (FRAMES, 1, 1)).astype(np.float32)
    return priors, upright(xyz, np.ones(xyz.shape[:2], bool))


def test_depth_of_what_moves_follows_its_nodes_and_nothing_else_does():
    priors, before = case()
    xyz = before.xyz.copy()
    xyz[0] *= np.where(xyz[0, :, :1] < 0.5, 1.1, 1.3)  # along the rays: the right column of nodes farther
    after = replace(before, xyz=xyz)
    found = carried_depth(priors, before, after)
    np.testing.assert_array_equal(found[~priors.mask], priors.depth[~priors.mask])
    np.testing.assert_array_equal(found[1], priors.depth[1])
    np.testing.assert_allclose(found[0, 12, 12], 4.4, rtol=0.02)
    np.testing.assert_allclose(found[0, 12, 48], 5.2, rtol=0.02)
    inside = found[0][priors.mask[0]]
    assert inside.min() >= 4.39 and inside.max() <= 5.21


def test_uncertain_nodes_do_not_move_depth():
    priors, before = case()
    before = replace(before, certain=np.zeros_like(before.certain))
    found = carried_depth(priors, before, replace(before, xyz=before.xyz * 2))
    np.testing.assert_array_equal(found, priors.depth)


def random_case():
    """Turned and shifted cameras, a mask of loose pixels, ten nodes at random of which some are uncertain or behind."""
    priors, _ = case()
    rng = np.random.default_rng(0)
    poses = priors.cameras.world_to_camera
    for t, pose in enumerate(poses):
        a = 0.1 * t
        pose[:3, :3] = [[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]]
        pose[:3, 3] = [0.2 * t, -0.1, 0.3 * t]
    priors.mask = rng.random((FRAMES, HEIGHT, WIDTH)) < 0.1
    priors.depth = rng.uniform(1, 3, priors.mask.shape).astype(np.float32)
    xyz = (rng.normal(size=(2, FRAMES, 10, 3)) * [1, 0.6, 0.3] + [0, 0, 2]).astype(np.float32)
    xyz[:, 1, 9] *= -1
    xyz[0, 1, 8, 2], xyz[1, 1, 7, 2] = -1, -1  # behind before, or behind after
    certain = rng.random((FRAMES, 10)) < 0.8
    certain[:, 7:] = True
    return priors, *(upright(each, certain.copy()) for each in xyz)


@pytest.mark.parametrize("most", [10, 4, 3, 1])
def test_a_pixel_takes_the_mean_change_of_its_four_nearest_nodes_by_squared_distance(most):
    """Logarithms of the nodes' depth ratios, weighed by 1 / (squared pixels + 1); fewer nodes where fewer are known."""
    priors, before, after = random_case()
    before.certain[0, most:] = False
    found = carried_depth(priors, before, after)
    for frame, pose in enumerate(priors.cameras.world_to_camera):
        nodes = []
        for node in np.flatnonzero(before.certain[frame]):
            old, new = (pose[:3, :3] @ each.xyz[frame, node].astype(float) + pose[:3, 3] for each in (before, after))
            if old[2] > 0 and new[2] > 0:
                pixel = FOCAL * new[:2] / new[2] + [WIDTH / 2, HEIGHT / 2]
                nodes.append((pixel, math.log(new[2] / old[2])))
        assert nodes
        for y, x in np.argwhere(priors.mask[frame]):
            squared = [((pixel - [x + 0.5, y + 0.5]) ** 2).sum() for pixel, _ in nodes]
            near = np.argsort(squared)[:4]
            weight = [1 / (squared[i] + 1) for i in near]
            change = sum(w * nodes[i][1] for w, i in zip(weight, near, strict=True)) / sum(weight)
            assert found[frame, y, x] == pytest.approx(priors.depth[frame, y, x] * math.exp(change), rel=1e-4)
    np.testing.assert_array_equal(found[~priors.mask], priors.depth[~priors.mask])


@pytest.mark.parametrize("side", [0, 1])
def test_a_node_in_the_plane_of_the_camera_says_nothing(side):
    priors, before = case()
    both = [before, replace(before, xyz=before.xyz * 1.5)]
    both[side] = replace(both[side], xyz=both[side].xyz.copy())
    both[side].xyz[0, 2] = 0
    found = carried_depth(priors, *both)
    np.testing.assert_allclose(found[priors.mask], 6, rtol=1e-5)


# ---- which tracks move -------------------------------------------------------------------------------------------------


def test_tracks_that_lie_in_the_mask_for_most_of_the_frames_that_see_them():
    rng = np.random.default_rng(0)
    frames, count = 10, 400
    priors = Priors(WIDTH, HEIGHT, np.arange(frames))
    priors.mask = rng.random((frames, HEIGHT, WIDTH)) < 0.6
    priors.mask[:, :, -1] = priors.mask[:, :, 0] = False
    size = np.array([WIDTH, HEIGHT])
    priors.tracks = rng.uniform(-0.03 * size, 1.03 * size, (frames, count, 2)).astype(np.float32)
    priors.tracks_visible = rng.random((frames, count)) < rng.uniform(0, 1, count)
    priors.tracks_visible[:, 0] = False
    priors.tracks_visible[1:, 1:4], priors.tracks_visible[0, 1:4] = False, True
    priors.tracks[0, 1], priors.tracks[0, 2], priors.tracks[0, 3] = (WIDTH + 9, 5.5), (-3, 5.5), (20.5, HEIGHT + 9)
    priors.mask[0, 5, -1], priors.mask[0, 5, 0], priors.mask[0, -1, 20] = True, True, True
    expected, even = [], 0
    for track in range(count):
        seen = np.flatnonzero(priors.tracks_visible[:, track])
        inside = 0
        for t in seen:
            x, y = (math.floor(value) for value in priors.tracks[t, track])
            inside += bool(priors.mask[t, min(max(y, 0), HEIGHT - 1), min(max(x, 0), WIDTH - 1)])
        if len(seen) and 10 * inside >= 6 * len(seen):
            expected.append(track)
            even += 10 * inside == 6 * len(seen)
    assert moving_tracks(priors).tolist() == expected
    assert expected[:3] == [1, 2, 3] and even > 3


# ---- nodes and how they were seen --------------------------------------------------------------------------------------


def test_nodes_are_seen_along_the_rays_of_their_tracks_with_the_confidence_of_its_pixel():
    priors, scaffold, _ = random_case()
    rng = np.random.default_rng(1)
    centre = priors.cameras.centers[1]
    scaffold.xyz[1, 4] = centre.astype(np.float32)
    scaffold.xyz[0, 5] = priors.cameras.centers[0] + [0, 0.1, 0.2]  # nearer than a unit
    priors.tracks = rng.uniform(0, 1, (FRAMES, 30, 2)).astype(np.float32) * [WIDTH, HEIGHT]
    tracks = rng.permutation(30)[:10]
    priors.tracks[0, tracks[:5]] = [[-3, 7], [9, -0.5], [WIDTH + 5, 7], [8, HEIGHT], [np.nan, 4.5]]
    priors.depth_confidence = rng.random(priors.depth.shape).astype(np.float16)
    found = start._sightlines(scaffold, priors, tracks)
    for t in range(FRAMES):
        for node, track in enumerate(tracks):
            ray = scaffold.xyz[t, node].astype(float) - priors.cameras.centers[t]
            length = np.linalg.norm(ray)
            if length > 1e-3:
                np.testing.assert_allclose(found.direction[t, node], ray / length, atol=1e-4)
            x, y = (0.0 if math.isnan(value) else float(value) for value in priors.tracks[t, track])
            row, column = int(min(max(y, 0), HEIGHT - 1)), int(min(max(x, 0), WIDTH - 1))
            assert found.confidence[t, node] == priors.depth_confidence[t, row, column]
    assert np.isfinite(found.direction).all()
    priors.depth_confidence = None
    assert start._sightlines(scaffold, priors, tracks) is None


def with_moving_tracks(seen: int, short: int = 0):
    """The toy's priors with so many tracks of the square, and others that are seen once; unequal confidence."""
    _, priors = toy.clip_and_priors(6)
    moving = np.flatnonzero(priors.tracks_motion == 1)
    priors.tracks_visible = priors.tracks_visible.copy()
    priors.tracks_visible[:, moving[seen + short :]] = False
    priors.tracks_visible[1:, moving[seen : seen + short]] = False
    priors.depth_confidence = np.random.default_rng(0).random(priors.depth.shape).astype(np.float16)
    return priors


@pytest.mark.parametrize(("seen", "short", "made"), [(7, 0, False), (8, 0, True), (7, 5, False), (8, 5, True)])
def test_eight_tracks_that_can_be_lifted_make_a_scaffold(seen, short, made):
    priors = with_moving_tracks(seen, short)
    config = profile("quick")
    config = replace(config, scaffold=replace(config.scaffold, geometry_steps=2, following_steps=2))
    begun = start_scaffold(priors, config, silent)
    assert (begun.scaffold is not None) == made == bool(begun.needs)
    if not made:
        assert begun.priors is priors


def test_the_scaffold_is_optimised_as_its_own_tracks_saw_it_and_depth_goes_along(monkeypatch):
    priors, config = with_moving_tracks(49), profile("quick")
    given = []

    def optimise(scaffold, settings, progress, sightlines, *_):
        given.append((scaffold, sightlines))
        return replace(scaffold, xyz=scaffold.xyz * [1.1, 1.1, 1.1])

    monkeypatch.setattr(start, "optimise_geometry", optimise)
    config = replace(config, scaffold=replace(config.scaffold, max_nodes=4, following_steps=0))
    begun = start_scaffold(priors, config, silent)
    ((scaffold, sightlines),) = given
    for t in range(6):
        pixels, _ = priors.cameras[t].project(scaffold.xyz[t])
        for node, pixel in enumerate(pixels):
            moving = priors.tracks[t][priors.tracks_motion == 1]
            track = np.linalg.norm(moving - pixel, axis=1).argmin()
            np.testing.assert_allclose(moving[track], pixel, atol=1e-3)
            column, row = np.floor(moving[track]).astype(int)
            assert sightlines.confidence[t, node] == priors.depth_confidence[t, row, column]
    np.testing.assert_allclose(begun.priors.depth[priors.mask], 1.1 * priors.depth[priors.mask], rtol=1e-5)
    (need,) = begun.needs
    assert (need.chosen, need.saved) == ("4", "0 nodes of at most 4")
