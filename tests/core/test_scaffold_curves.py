"""Lifting, curve distance, node selection, graph and first rotations, against brute force and made-up motions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from f4x_core.errors import F4xError
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import distance
from f4x_core.scaffold.distance import curve_distance, distance_to
from f4x_core.scaffold.graph import DISTANCE_CAP, GraphConfig, attach_nodes, build_graph, multilevel_edges
from f4x_core.scaffold.lifting import LiftedTracks, LiftingConfig, fill_gaps, lift_tracks, nearest_valid_depth
from f4x_core.scaffold.rotation import initial_rotations
from f4x_core.scaffold.selection import (
    SelectionConfig,
    automatic_unit,
    choose_nodes,
    scaffold_of,
    track_noise,
    track_residuals,
)

TIMES = np.arange(24.0)


def rigid_motion(points, times=TIMES, turn=2.0):
    """Move `points (N, 3)` along a turning, travelling path: `(F, N, 3)`."""
    s = (times - times[0]) / max(times[-1] - times[0], 1)
    q = quaternion.from_rotation_vector(np.array([0.2, turn, 0.3]) * s[:, None])
    t = np.stack([0.4 * s, 0.05 * np.sin(6 * s), np.ones_like(s)], 1)
    return pose.transform(q[:, None], t[:, None], points[None])


def lifted_from(xyz, certain=None):
    certain = np.ones(xyz.shape[:2], bool) if certain is None else certain
    return LiftedTracks(fill_gaps(xyz, certain, TIMES[: len(xyz)]).astype(np.float32), certain, np.arange(xyz.shape[1]))


def mover(seed=0, number=300, kind="rigid", noise=0.0):
    """A box (and, when jointed, a thin limb that swings on it) as lifted tracks."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.15, 0.15, (number, 3))
    if kind == "rigid":
        xyz = rigid_motion(points)
    else:
        limb = np.arange(number) % 3 == 0
        points[limb] = rng.uniform([0.2, -0.03, -0.03], [0.4, 0.03, 0.03], (limb.sum(), 3))
        swing = quaternion.from_rotation_vector(np.array([0, 0, 1.0]) * np.sin(TIMES * 0.5)[:, None])
        moved = np.repeat(points[None], len(TIMES), 0)
        moved[:, limb] = pose.transform(swing[:, None], np.array([0.2, 0, 0]), points[limb] - [0.2, 0, 0])
        xyz = np.stack([rigid_motion(moved[f])[f] for f in range(len(TIMES))])
    return lifted_from(xyz + noise * rng.normal(size=xyz.shape))


# ---- lifting ---------------------------------------------------------------------------------------------------------


def cameras(frames=6, width=32, height=24):
    k = np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]])
    pose_matrices = np.repeat(np.eye(4)[None], frames, 0)
    pose_matrices[:, 0, 3] = -0.1 * np.arange(frames)
    return CameraPath(np.repeat(k[None], frames, 0), pose_matrices, np.arange(frames) * 2.0, width, height)


def test_lifting_returns_the_world_points():
    path = cameras()
    rng = np.random.default_rng(0)
    start = rng.uniform([-0.3, -0.2, 0.9], [0.3, 0.2, 1.1], (30, 3))
    truth = start[None] + np.array([0.02, 0, 0]) * np.arange(6)[:, None, None]
    tracks, depth = np.zeros((6, 30, 2)), np.full((6, 24, 32), np.nan)
    for f in range(6):
        tracks[f], z = path[f].project(truth[f])
        column, row = np.floor(tracks[f]).astype(int).T
        inside = (column >= 0) & (column < 32) & (row >= 0) & (row < 24)
        depth[f, row[inside], column[inside]] = z[inside]
    lifted = lift_tracks(tracks, np.ones((6, 30), bool), depth, path, path.times, LiftingConfig(search_px=0))
    assert len(lifted) > 20
    error = np.linalg.norm(lifted.xyz - truth[:, lifted.index], axis=-1)
    assert np.median(error) < 1e-6  # two tracks in one pixel share its depth, hence the median
    assert lifted.certain.mean() > 0.8


def test_tracks_without_depth_outside_the_picture_or_unknown_are_not_certain():
    path = cameras()
    tracks = np.tile(np.array([[16.2, 12.1], [100.0, 5], [np.nan, np.nan], [3.5, 3.5]]), (6, 1, 1))
    depth = np.ones((6, 24, 32))
    depth[:, :8, :8] = np.nan
    lifted = lift_tracks(tracks, np.ones((6, 4), bool), depth, path, path.times)
    assert lifted.index.tolist() == [0]
    assert lift_tracks(tracks, np.zeros((6, 4), bool), depth, path, path.times).xyz.shape == (6, 0, 3)


def test_frame_counts_must_match():
    with pytest.raises(F4xError, match="same frames"):
        lift_tracks(np.zeros((6, 1, 2)), np.ones((6, 1), bool), np.ones((5, 24, 32)), cameras(), np.arange(6.0))


def test_nearest_valid_depth_equals_brute_force():
    rng = np.random.default_rng(0)
    depth, valid = rng.uniform(1, 2, (12, 15)), rng.random((12, 15)) > 0.8
    pixels = rng.uniform(-1, 16, (200, 2))
    actual = nearest_valid_depth(pixels, depth, valid, 2)
    for pixel, z in zip(pixels, actual, strict=True):
        column, row = np.floor(pixel).astype(int)
        best, expected = np.inf, np.nan
        if 0 <= column < 15 and 0 <= row < 12:
            for r in range(max(row - 2, 0), min(row + 3, 12)):
                for c in range(max(column - 2, 0), min(column + 3, 15)):
                    squared = (c + 0.5 - pixel[0]) ** 2 + (r + 0.5 - pixel[1]) ** 2
                    if valid[r, c] and squared < best:
                        best, expected = squared, depth[r, c]
        np.testing.assert_equal(z, expected)


def test_gaps_are_filled_along_lines_in_time_and_ends_held():
    times = np.array([0.0, 1, 2, 4, 8])
    xyz = np.zeros((5, 3, 3))
    xyz[:, 0, 0] = [9, 1, 9, 4, 9]
    certain = np.zeros((5, 3), bool)
    certain[[1, 3], 0] = True
    certain[2, 1] = True
    xyz[2, 1] = 5
    xyz[:, 2, 0] = np.arange(5)
    filled = fill_gaps(xyz, certain, times)
    np.testing.assert_allclose(filled[:, 0, 0], [1, 1, 2, 4, 4])
    np.testing.assert_array_equal(filled[:, 1], 5)
    np.testing.assert_array_equal(filled[:, 2], xyz[:, 2])


def test_shaking_and_outlying_samples_are_dropped():
    path = cameras(frames=8)
    grid = np.stack(np.meshgrid(np.arange(4, 28) + 0.5, np.arange(4, 20) + 0.5), -1).reshape(-1, 2)
    tracks, depth = np.repeat(grid[None], 8, 0), np.ones((8, 24, 32))
    depth[3, 10, 15] = 1.5  # one jump in depth of one track
    depth[6, 8, 20] = 40.0
    config = LiftingConfig(search_px=0)
    lifted = lift_tracks(tracks, np.ones((8, len(grid)), bool), depth, path, path.times, config)
    jumping = np.flatnonzero((grid == [15.5, 10.5]).all(1))[0]
    flying = np.flatnonzero((grid == [20.5, 8.5]).all(1))[0]
    place = {track: i for i, track in enumerate(lifted.index)}  # the corners of a grid are outliers in every frame
    assert np.flatnonzero(~lifted.certain[:, place[jumping]]).tolist() == [3]
    assert np.flatnonzero(~lifted.certain[:, place[flying]]).tolist() == [6]
    assert lifted.certain.mean() > 0.98
    np.testing.assert_allclose(lifted.xyz[3, place[jumping], 2], 1, atol=1e-6)


def test_shaking_is_measured_in_time():
    path = cameras(frames=8)
    tracks, depth = np.repeat(np.array([[[15.5, 10.5], [16.5, 12.5]]]), 8, 0), np.ones((8, 24, 32))
    depth[3, 10, 15] = 1.5
    arguments = (tracks, np.ones((8, 2), bool), depth, path, path.times)
    lifted = lift_tracks(*arguments, LiftingConfig(search_px=0))
    # the jump also bends the line through its neighbours
    assert np.flatnonzero(~lifted.certain[:, 0]).tolist() == [2, 3, 4] and lifted.certain[:, 1].all()
    dropped = lift_tracks(*arguments, LiftingConfig(search_px=0, drop_shaking_curves=True))
    assert dropped.index.tolist() == [1]


@pytest.mark.parametrize("frames", [1, 2])
def test_short_clips_lift(frames):
    path = cameras(frames=frames)
    tracks = np.tile(np.array([[16.2, 12.1], [10.0, 5.0]]), (frames, 1, 1))
    lifted = lift_tracks(tracks, np.ones((frames, 2), bool), np.ones((frames, 24, 32)), path, path.times)
    assert lifted.xyz.shape == (frames, 2, 3) and lifted.certain.all()


# ---- distance --------------------------------------------------------------------------------------------------------


def brute_distance(xyz, certain, kth):
    frames, nodes = xyz.shape[:2]
    result = np.zeros((nodes, nodes))
    for i in range(nodes):
        for j in range(nodes):
            if i != j:
                common = np.ones(frames, bool) if certain is None else certain[:, i] & certain[:, j]
                d = np.sort(np.linalg.norm(xyz[common, i] - xyz[common, j], axis=-1))[::-1]
                k = max(int(np.ceil(kth * common.sum() / frames)), 1)
                result[i, j] = d[k - 1] if common.any() else np.inf
    return result


@pytest.mark.parametrize("kth", [1, 3])
@pytest.mark.parametrize("masked", [False, True])
def test_curve_distance_equals_brute_force(kth, masked, monkeypatch):
    monkeypatch.setattr(distance, "CHUNK", 3)  # of `distance_to`: several blocks
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(10, 12, 3)).astype(np.float32)
    xyz[:, 5] = xyz[:, 2]  # duplicates
    certain = rng.random((10, 12)) > 0.5 if masked else None
    if masked:
        certain[:, 7] = False  # never seen together with anything
    expected = brute_distance(xyz, certain, kth)
    for chunk in (1, 7, 10_000):
        actual = curve_distance(xyz, certain, kth, chunk)
        np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(actual, actual.T)
    if not masked:
        assert actual[5, 2] == 0
    other = distance_to(
        xyz[:, :4],
        xyz[:, 4:],
        None if certain is None else certain[:, :4],
        None if certain is None else certain[:, 4:],
        kth,
    )
    np.testing.assert_allclose(other, expected[:4, 4:], rtol=1e-5, atol=1e-6)
    if not masked:  # what was seen of one side alone says nothing about both
        alone = distance_to(xyz[:, :4], xyz[:, 4:], np.zeros((10, 4), bool), kth=kth)
        np.testing.assert_array_equal(alone, other)


def test_curve_distance_of_one_or_no_curve():
    assert curve_distance(np.zeros((3, 1, 3))).tolist() == [[0.0]]
    assert curve_distance(np.zeros((3, 0, 3))).shape == (0, 0)


# ---- selection -------------------------------------------------------------------------------------------------------


def test_automatic_unit_scales_with_the_scene():
    tracks = mover()
    np.testing.assert_allclose(automatic_unit(tracks.xyz * 10, 3.0), 10 * automatic_unit(tracks.xyz, 3.0), rtol=1e-5)


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_a_rigid_mover_needs_few_nodes(noise):
    chosen = choose_nodes(mover(noise=noise), TIMES, tolerance=0.01)
    assert len(chosen.index) <= 8
    assert chosen.residual < max(0.01, 4 * noise)


def test_a_jointed_mover_needs_more_and_the_table_says_why():
    tracks = mover(kind="jointed", number=900)
    chosen = choose_nodes(tracks, TIMES, tolerance=0.01)
    assert chosen.met and len(chosen.index) > 8
    assert [row.nodes for row in chosen.table] == sorted(row.nodes for row in chosen.table)
    assert all(row.residual > 0.01 for row in chosen.table[:-1]) and chosen.table[-1].residual <= 0.01
    assert len(set(chosen.index)) == len(chosen.index)
    loose = choose_nodes(tracks, TIMES, tolerance=0.2)
    assert len(loose.index) < len(chosen.index)


def test_nodes_are_not_as_many_as_tracks():
    tracks = mover(kind="jointed", number=40, noise=0.001)
    tried = [row.nodes for row in choose_nodes(tracks, TIMES, 0.0).table]
    assert tried[-1] == 16, "32 of 40 tracks would carry the others by being them"
    forced = choose_nodes(tracks, TIMES, 0.0, SelectionConfig(counts=(24,)))
    assert len(forced.index) == 24, "but who asks for one count gets it"


def test_tolerance_in_pixels():
    k = np.array([[200.0, 0, 100], [0, 200, 100], [0, 0, 1]])
    path = CameraPath(np.repeat(k[None], 24, 0), np.repeat(np.eye(4)[None], 24, 0), TIMES, 200, 200)
    tracks = mover(noise=0.003)
    world, pixels = choose_nodes(tracks, TIMES, 0.01), choose_nodes(tracks, TIMES, 2.0, cameras=path)
    assert pixels.pixels and not world.pixels
    assert 50 < pixels.table[0].residual / world.table[0].residual < 400  # 200 px / unit at depth 1
    assert 50 < pixels.noise / world.noise < 400


def test_noise_is_measured_from_the_tracks():
    rng = np.random.default_rng(0)
    still = np.repeat(rng.normal(size=(1, 400, 3)), 200, 0)
    tracks = LiftedTracks(still + 0.01 * rng.normal(size=still.shape), np.ones(still.shape[:2], bool), np.arange(400))
    distance_of_two_samples = np.linalg.norm(0.01 * rng.normal(size=(100_000, 3)) * np.sqrt(2), axis=1)
    expected = np.median(distance_of_two_samples)
    np.testing.assert_allclose(track_noise(tracks, np.arange(200.0)).mean(), expected, rtol=0.03)


@pytest.mark.parametrize(("frames", "number"), [(1, 5), (2, 5), (24, 1), (24, 2)])
def test_tiny_inputs_choose_nodes(frames, number):
    tracks = mover(number=number)
    tracks = LiftedTracks(tracks.xyz[:frames], tracks.certain[:frames], tracks.index)
    chosen = choose_nodes(tracks, TIMES[:frames], 0.01)
    scaffold = scaffold_of(tracks, chosen.index, TIMES[:frames], chosen.unit)
    assert len(scaffold) >= 1
    assert np.isfinite(track_residuals(scaffold, tracks)).all()


def test_tracks_that_coincide_or_never_meet():
    same = lifted_from(np.repeat(rigid_motion(np.zeros((1, 3))), 20, 1))
    chosen = choose_nodes(same, TIMES, 0.01)
    assert chosen.residual < 1e-5 and chosen.unit > 0
    apart = mover(number=20)
    apart.certain[:12, :10] = False
    apart.certain[12:, 10:] = False
    assert np.isfinite(choose_nodes(lifted_from(apart.xyz, apart.certain), TIMES, 0.01).residual)


def test_no_track_is_said_clearly():
    with pytest.raises(F4xError, match="static"):
        choose_nodes(mover().subset(np.zeros(0, int)), TIMES, 0.01)


# ---- graph -----------------------------------------------------------------------------------------------------------


def test_graph_rows_are_the_node_then_its_nearest():
    x = np.array([0.0, 1, 3, 7, 7])  # the last two coincide
    distance = abs(x[:, None] - x[None])
    neighbours, mask = build_graph(distance, 3, reach=2.5)
    np.testing.assert_array_equal(neighbours, [[0, 1, 2], [1, 0, 2], [2, 1, 0], [3, 4, 2], [4, 3, 2]])
    np.testing.assert_array_equal(mask, [[1, 1, 0], [1, 1, 1], [1, 1, 0], [1, 1, 0], [1, 1, 0]])


def test_graph_keeps_groups_and_unseen_pairs_apart_and_pads():
    distance = np.array([[0.0, 0.1, np.inf], [0.1, 0, 0.2], [np.inf, 0.2, 0]])
    neighbours, mask = build_graph(distance, 5, reach=np.inf)
    assert neighbours.shape == (3, 5)
    np.testing.assert_array_equal(neighbours[0], [0, 1, 2, 0, 0])
    np.testing.assert_array_equal(mask[0], [1, 1, 0, 0, 0])
    _, mask = build_graph(distance, 3, reach=1.0, groups=np.array([0, 1, 1]))
    np.testing.assert_array_equal(mask, [[1, 0, 0], [1, 1, 0], [1, 1, 0]])
    assert DISTANCE_CAP > 1e3


def test_coarse_edges_lead_to_a_thin_set_and_are_reproducible():
    tracks = mover()
    distance = curve_distance(tracks.xyz)
    config = GraphConfig(levels=((4.0, 3, 0.5),))
    (level,) = multilevel_edges(distance, 0.02, config, seed=3)
    members = np.unique(level.neighbour)
    assert len(members) < 60
    between = distance[np.ix_(members, members)]
    assert between[~np.eye(len(members), dtype=bool)].min() > 0.08
    assert (distance[level.node, level.neighbour] < 5 * 0.08).all() and (level.node != level.neighbour).all()
    assert np.bincount(level.node).max() <= 3
    np.testing.assert_array_equal(multilevel_edges(distance, 0.02, config, seed=3)[0].neighbour, level.neighbour)


def test_coarse_edges_reach_so_many_of_their_spacings():
    x = np.array([0.0, 1.5, 3.5, 30.0, 33.0, 38.0])
    distance = np.abs(x[:, None] - x)
    config = GraphConfig(reach=4.0, levels=((2.0, 9, 0.3),))  # spacing 1, so that all are members; edges below 4
    (level,) = multilevel_edges(distance, 0.5, config, seed=0)
    wanted = {(i, j) for i in range(6) for j in range(6) if i != j and distance[i, j] < 4}
    assert set(zip(level.node.tolist(), level.neighbour.tolist(), strict=True)) == wanted and len(wanted) == 8


def test_attach_is_the_nearest_node_at_the_reference_frame():
    rng = np.random.default_rng(0)
    points, reference, xyz = rng.normal(size=(50, 3)), rng.integers(0, 4, 50), rng.normal(size=(4, 9, 3))
    expected = np.linalg.norm(xyz[reference] - points[:, None], axis=-1).argmin(1)
    np.testing.assert_array_equal(attach_nodes(points, reference, xyz), expected)


# ---- rotations -------------------------------------------------------------------------------------------------------


def test_rotations_of_a_rigid_motion_are_found():
    xyz = rigid_motion(np.random.default_rng(0).normal(size=(20, 3)), turn=9.0)
    neighbours = np.stack([np.roll(np.arange(20), -i)[:6] for i in range(20)])
    q = initial_rotations(neighbours, np.ones_like(neighbours, bool), xyz)
    truth = quaternion.from_rotation_vector(np.array([0.2, 9.0, 0.3]) * np.linspace(0, 1, 24)[:, None])[:, None]
    np.testing.assert_allclose(abs((q * truth).sum(-1)), 1, atol=1e-10)
    assert ((q[1:] * q[:-1]).sum(-1) > 0).all()


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
def test_three_neighbours_tell_a_turn_wherever_they_are_and_in_any_unit(unit):
    """Also where none was observed: then what was filled in counts."""
    rest = np.random.default_rng(0).normal(size=(4, 3)) + np.array([5, -3, 8])
    turn = quaternion.from_rotation_vector(np.array([0.4, -0.7, 0.2]))
    xyz = unit * np.stack([rest, quaternion.rotate(turn, rest), rest])
    neighbours, mask = np.array([[0, 1, 2, 3], [1, 3, 0, 2]]), np.array([[True] * 3 + [False]] * 2)
    for certain in (None, np.zeros((3, 4), bool)):
        found = initial_rotations(neighbours, mask, xyz, certain)
        np.testing.assert_allclose(np.abs(found[1] @ turn), 1, atol=1e-9)
        np.testing.assert_allclose(np.abs(found[2] @ quaternion.IDENTITY), 1, atol=1e-9)


def test_samples_that_were_filled_in_count_a_hundredth():
    rng = np.random.default_rng(3)
    before, after = rng.normal(size=(2, 6, 3)) + np.array([2, 1, -3])
    certain = np.array([[True] * 6, [True] * 3 + [False] * 3])
    found = initial_rotations(np.arange(6)[None], np.ones((1, 6), bool), np.stack([before, after]), certain)[1, 0]
    weights = np.array([1.0] * 3 + [0.01] * 3)
    here, there = (side - np.average(side, axis=0, weights=weights) for side in (before, after))
    best = Rotation.align_vectors(there, here, weights)[0].as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs(found @ best), 1, atol=1e-9)


def test_undetermined_rotations_stay():
    xyz = rigid_motion(np.outer(np.arange(6), [1.0, 0, 0]))  # collinear
    neighbours = np.tile(np.arange(6), (6, 1))
    mask = np.ones((6, 6), bool)
    q = initial_rotations(neighbours, mask, xyz)
    np.testing.assert_array_equal(q, np.broadcast_to(quaternion.IDENTITY, q.shape))
    two = initial_rotations(
        neighbours, np.arange(6) < np.full((6, 1), 2), np.random.default_rng(0).normal(size=(5, 6, 3))
    )
    np.testing.assert_array_equal(two, np.broadcast_to(quaternion.IDENTITY, two.shape))
    same = initial_rotations(neighbours, mask, np.zeros((5, 6, 3)))
    np.testing.assert_array_equal(same, np.broadcast_to(quaternion.IDENTITY, same.shape))


def test_planar_neighbourhoods_give_proper_rotations():
    flat = np.random.default_rng(0).normal(size=(12, 3)) * [1, 1, 0]
    neighbours = np.tile(np.arange(12), (12, 1))
    q = initial_rotations(neighbours, np.ones((12, 12), bool), rigid_motion(flat, turn=3.0))
    truth = quaternion.from_rotation_vector(np.array([0.2, 3.0, 0.3]))
    np.testing.assert_allclose(abs(q[-1] @ truth), 1, atol=1e-9)
