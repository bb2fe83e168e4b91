"""Which tracks become nodes, each rule of it beside loops that say it plainly."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold.deformation import deform, pairs_of
from f4x_core.scaffold.graph import GraphConfig
from f4x_core.scaffold.lifting import LiftedTracks, fill_gaps
from f4x_core.scaffold.radius import RadiusConfig
from f4x_core.scaffold.rotation import initial_rotations
from f4x_core.scaffold.selection import (
    MIN_COMMON,
    Selection,
    SelectionConfig,
    automatic_unit,
    choose_nodes,
    scaffold_of,
    track_noise,
    track_residuals,
)
from f4x_core.scaffold.skinning import skinning_weights

FRAMES, TRACKS = 8, 48
TIMES = np.array([0.0, 1, 2, 4, 5, 6, 8, 9])


@pytest.fixture(scope="module")
def tracks() -> LiftedTracks:
    """Two crowds that turn differently, each track unseen in some frames."""
    rng = np.random.default_rng(0)
    rest = rng.uniform(-0.2, 0.2, (TRACKS, 3)) + np.where(np.arange(TRACKS) % 3, 0.0, 0.5)[:, None]
    turn = quaternion.from_rotation_vector(0.1 * TIMES[:, None, None] * np.array([[0, 1.0, 0.3]]))
    back = quaternion.conjugate(turn)
    xyz = np.where((np.arange(TRACKS) % 3 == 0)[:, None], quaternion.rotate(back, rest), quaternion.rotate(turn, rest))
    xyz = xyz + [0, 0, 3] + 0.002 * rng.normal(size=xyz.shape)
    certain = rng.random((FRAMES, TRACKS)) < 0.8
    certain[:4, 5] = certain[4:, 6] = False  # never seen together
    certain[4, 5] = certain[3, 6] = True
    return LiftedTracks(fill_gaps(xyz, certain, TIMES).astype(np.float32), certain, np.arange(TRACKS))


def apart(lifted: LiftedTracks, i: int, j: int) -> float:
    """Largest distance of two curves over the frames that see both, over all frames where none does."""
    distance = np.linalg.norm(lifted.xyz[:, i].astype(float) - lifted.xyz[:, j], axis=-1)
    both = lifted.certain[:, i] & lifted.certain[:, j]
    return float(distance[both].max() if both.any() else distance.max())


def farthest_first(lifted: LiftedTracks, count: int) -> tuple[list[int], list[float]]:
    """From the curve that was seen most; with each, the distance within which 95 % have one of those so far."""
    order, covering = [int(np.argmax(lifted.certain.sum(0)))], []
    while True:
        nearest = [min(apart(lifted, i, j) for j in order) for i in range(len(lifted))]
        covering.append(float(np.quantile(nearest, 0.95)))
        if len(order) == count:
            return order, covering
        order.append(int(np.argmax(nearest)))


def middles(lifted: LiftedTracks, seeds: list[int]) -> list[int]:
    """Of the curves that are nearest to each seed (largest distance over all frames) the one nearest to their mean."""
    distance = np.array(
        [
            [np.linalg.norm(lifted.xyz[:, i].astype(float) - lifted.xyz[:, s], axis=-1).max() for s in seeds]
            for i in range(len(lifted))
        ]
    )
    cell, found = distance.argmin(1), []
    for number in range(len(seeds)):
        members = np.flatnonzero(cell == number)
        curves = lifted.xyz[:, members].astype(float)
        off = np.linalg.norm(curves - curves.mean(1, keepdims=True), axis=-1).mean(0)
        found.append(int(members[off.argmin()]))
    return found


CONFIG = SelectionConfig(counts=(2, 3, 5, 8), held_out=0.3, quantile=0.7, slack=0.25, candidates=20, seed=3, support=6)


def written_out(lifted: LiftedTracks, config: SelectionConfig) -> list[tuple[list[int], float, float, float]]:
    """(nodes, unit, residual, median) for each count, all of them tried."""
    drawn = np.random.default_rng(config.seed).permutation(len(lifted))[: int(config.held_out * len(lifted))]
    longest = sorted(set(range(len(lifted))) - set(drawn), key=lambda i: (-lifted.certain[:, i].sum(), i))
    candidates = np.array(sorted(longest[: config.candidates]))
    nodes, rows = lifted.subset(candidates), []
    order, covering = farthest_first(nodes, max(config.counts))
    for count in config.counts:
        pick = middles(nodes, order[:count])
        unit = max(covering[count - 1], automatic_unit(nodes.xyz, 1.0))
        left = track_residuals(scaffold_of(nodes, pick, TIMES, unit, config), lifted.subset(np.sort(drawn)))
        rows.append((candidates[pick].tolist(), unit, np.quantile(left, config.quantile), np.median(left)))
    return rows


def test_nodes_are_chosen_as_written_out(tracks):
    rows = written_out(tracks, CONFIG)
    noise = float(np.median(track_noise(tracks, TIMES)))
    residuals = [row[2] for row in rows]
    tolerances = {
        0.0: next(i for i, r in enumerate(residuals) if r <= max(1.25 * min(residuals), 2 * noise)),
        residuals[1] * 1.001: 1,
        residuals[0] * 1.001: 0,
    }
    assert min(residuals) > 2 * noise and residuals[0] > residuals[1] > residuals[2], "or the cases below are none"
    for tolerance, best in tolerances.items():
        found = choose_nodes(tracks, TIMES, tolerance, CONFIG)
        assert found.index.tolist() == rows[best][0]
        assert (found.unit, found.residual) == pytest.approx((rows[best][1], rows[best][2]), rel=1e-5)
        assert found.tolerance == tolerance and found.noise == pytest.approx(noise)
        assert found.met == (found.residual <= tolerance) and not found.pixels
        tried = len(rows) if tolerance == 0 else best + 1
        assert [row.nodes for row in found.table] == [len(row[0]) for row in rows[:tried]]
        for row, (_, unit, residual, median) in zip(found.table, rows[:tried], strict=True):
            assert (row.unit, row.residual, row.median) == pytest.approx((unit, residual, median), rel=1e-5)


def test_counts_are_tried_while_there_is_room_and_tracks_enough(tracks):
    def tried(**changes):
        return [row.nodes for row in choose_nodes(tracks, TIMES, 0.0, replace(CONFIG, slack=0.0, **changes)).table]

    assert tried() == [2, 3, 5, 8]
    assert tried(maximum=5) == [2, 3, 5]
    assert tried(maximum=4) == [2, 3, 4]
    assert tried(tracks_per_node=6.0) == [2, 3, 5, 8], "six for each of eight"
    assert tried(tracks_per_node=6.1) == [2, 3, 5]
    assert tried(tracks_per_node=30.0) == [2], "the least is tried anyway"
    assert tried(candidates=6) == [2, 3, 5, 6]


def test_twice_the_noise_of_the_tracks_is_good_enough(tracks):
    jitter = (0.1 * np.random.default_rng(1).normal(size=tracks.xyz.shape)).astype(np.float32)
    shaken, outcomes = LiftedTracks(tracks.xyz + jitter, tracks.certain, tracks.index), []
    noise = float(np.median(track_noise(shaken, TIMES)))
    for quantile in (0.0, 0.05, 0.1, 0.3, 0.5, 0.7):
        found = choose_nodes(shaken, TIMES, 0.0, replace(CONFIG, quantile=quantile))
        assert found.noise == pytest.approx(noise)
        outcomes.append(found.table[0].residual / noise)
        assert (len(found.table) == 1) == (outcomes[-1] <= 2)
    assert min(outcomes) < 1.9 and max(outcomes) > 2.1


@pytest.mark.parametrize("lost", [0.0, 1.0])
def test_where_tracks_are_lost_the_median_chooses(tracks, lost):
    """Some tracks jump away and back, which more nodes follow: their residual rises, the median falls."""
    jumping, xyz = np.arange(0, TRACKS, 5), tracks.xyz.copy()
    xyz[::2, jumping] += np.random.default_rng(2).normal(0, 0.5, (len(jumping), 3)).astype(np.float32)
    lens = np.array([[80.0, 0, 40], [0, 90, 30], [0, 0, 1]])
    path = CameraPath(np.tile(lens, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), TIMES, 80, 60)
    config = replace(CONFIG, quantile=0.9, slack=0.0, counts=(2, 4, 8, 12), lost=lost, candidates=36)
    found = choose_nodes(LiftedTracks(xyz, tracks.certain, tracks.index), TIMES, 0.0, config, path)
    residuals, medians = ([getattr(row, name) for row in found.table] for name in ("residual", "median"))
    assert np.argmin(residuals) != np.argmin(medians), "or there is nothing to choose"
    best = int(np.argmin(medians if lost == 0 else residuals))
    assert found.by_median == (lost == 0)
    assert len(found.index) == found.table[best].nodes and found.median == medians[best]


def test_without_tracks_to_measure_it_the_residual_is_nothing(tracks):
    """Where nearly every track is a node, the unit is the distance of neighbouring tracks."""
    found = choose_nodes(
        tracks, TIMES, 0.0, replace(CONFIG, held_out=0.0, counts=(48,), candidates=48, tracks_per_node=1)
    )
    assert [(row.nodes, row.residual, row.median) for row in found.table] == [(48, 0, 0)]
    assert found.unit == pytest.approx(automatic_unit(tracks.xyz, 1.0))
    assert found.index.tolist() != [] and len(set(found.index.tolist())) == 48


def test_a_selection_is_met_within_its_tolerance():
    found = Selection(np.zeros(1, np.int64), 1.0, 0.5, 0.5, 0.1, False, ())
    assert found.met and not replace(found, residual=0.51).met


@pytest.mark.parametrize("pixels", [False, True])
def test_residuals_are_means_over_the_other_frames_that_see_the_track(tracks, pixels):
    """Track by track: it starts at the middle frame of those that see it, and hangs on the node that is nearest there."""
    seen = tracks.certain.copy()
    seen[:, 1], seen[:, 2] = False, False
    seen[3, 2] = True
    seen[:, 7] = False
    seen[[2, 5], 7] = True
    tracks = LiftedTracks(tracks.xyz, seen, tracks.index)
    scaffold = scaffold_of(tracks, np.array([0, 4, 9, 13, 22]), TIMES, 0.2)
    path = None
    if pixels:
        lens = np.array([[80.0, 0, 40], [0, 90, 30], [0, 0, 1]])
        path = CameraPath(np.tile(lens, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), TIMES, 80, 60)
    found = track_residuals(scaffold, tracks, path)
    for i in range(TRACKS):
        frames = np.flatnonzero(seen[:, i])
        if len(frames) < 2:
            assert found[i] == 0
            continue
        middle, off = int(frames[len(frames) // 2]), []
        start = tracks.xyz[middle, i]
        attach = int(np.linalg.norm(scaffold.xyz[middle] - start, axis=-1).argmin())
        near = scaffold.neighbours[[attach]]
        weights = skinning_weights(
            start[None], scaffold.xyz[middle, near], scaffold.radius[near], scaffold.edge_mask[[attach]]
        )
        pairs = pairs_of(near, np.array([middle]))
        for frame in frames:
            if frame != middle:
                motion = deform(TIMES, scaffold.xyz, scaffold.quat, pairs, weights, TIMES[frame])
                carried, truth = pose.transform(*motion, start[None])[0], tracks.xyz[frame, i]
                if path is not None:
                    carried, truth = (path.at(TIMES[frame]).project(p[None])[0][0] for p in (carried, truth))
                off.append(np.linalg.norm(carried - truth))
        np.testing.assert_allclose(found[i], np.mean(off), rtol=2e-4, atol=1e-6)


def test_a_scaffold_of_tracks_has_their_graph_and_turns_as_the_tracks_around_them(tracks):
    index, unit = np.array([3, 8, 14, 21, 30, 41]), 0.11
    config = SelectionConfig(
        support=5, graph=GraphConfig(neighbours=4, reach=3.0), radius=RadiusConfig(initial=1.5, maximum=4.0)
    )
    made = scaffold_of(tracks, index, TIMES, unit, config)
    np.testing.assert_array_equal(made.xyz, tracks.xyz[:, index])
    np.testing.assert_array_equal(made.certain, tracks.certain[:, index])
    np.testing.assert_allclose(made.radius, 1.5 * unit, rtol=1e-6)
    assert made.ids.tolist() == list(range(6)) and made.unit == unit and made.neighbours.shape == (6, 4)
    nodes = tracks.subset(index)
    both = nodes.certain[:, :, None] & nodes.certain[:, None]
    distance = np.where(both, np.linalg.norm(nodes.xyz[:, :, None] - nodes.xyz[:, None], axis=-1), 0).max(0)
    for m in range(6):
        assert made.neighbours[m].tolist() == [m, *[i for i in np.argsort(distance[m], kind="stable") if i != m][:3]]
        assert made.edge_mask[m].tolist() == [True, *(distance[m, made.neighbours[m, 1:]] < 3 * unit)]
    far = np.linalg.norm(tracks.xyz[:, index, None] - tracks.xyz[:, None], axis=-1).max(0)
    support = np.argsort(far, axis=1, kind="stable")[:, :5]
    turns = initial_rotations(support, np.ones((6, 5), bool), tracks.xyz, tracks.certain)
    np.testing.assert_allclose(made.quat, turns, atol=1e-6)
    still = scaffold_of(tracks, index, TIMES, unit, replace(config, rotations="identity"))
    assert (still.quat == quaternion.IDENTITY).all() and still.quat.shape == (FRAMES, 6, 4)


def test_the_unit_of_a_lone_track_is_a_hundredth_and_that_of_few_reaches_as_far_as_they_are():
    assert automatic_unit(np.zeros((4, 1, 3)), 3.0) == pytest.approx(0.03)
    pair = np.zeros((4, 2, 3))
    pair[:, 1, 0] = 0.7
    assert automatic_unit(pair, 3.0) == pytest.approx(2.1)


def test_noise_is_that_of_uneven_third_differences():
    """Divided differences vanish on parabolas whatever the intervals; normalised they keep the variance of one sample."""
    rng = np.random.default_rng(2)
    parabola = np.stack([TIMES**k for k in range(3)], -1) @ rng.normal(size=(3, 5 * 3)) * 1e-2
    xyz = parabola.reshape(FRAMES, 5, 3)
    certain = np.ones((FRAMES, 5), bool)
    certain[4, 1] = False
    smooth = LiftedTracks(xyz, certain, np.arange(5))
    assert track_noise(smooth, TIMES).max() < 1e-10
    jitter = rng.normal(size=xyz.shape)
    found = track_noise(replace(smooth, xyz=xyz + jitter), TIMES)
    for i in range(5):
        sizes = []
        for f in range(FRAMES - 3):
            if certain[f : f + 4, i].all():
                t = TIMES[f : f + 4]
                w = np.array([1 / np.prod([t[a] - t[b] for b in range(4) if b != a]) for a in range(4)])
                sizes.append(np.linalg.norm(w / np.linalg.norm(w) @ jitter[f : f + 4, i]))
        assert found[i] == pytest.approx(np.sqrt(2) * np.median(sizes), rel=1e-6)
    short = LiftedTracks(xyz[:3], certain[:3], np.arange(5))
    assert track_noise(short, TIMES[:3]).tolist() == [0.0] * 5


def test_what_all_tracks_do_alike_is_no_noise():
    """An unsteady path of the camera shakes every track of a car in the world; of a few tracks nobody can tell."""
    rng = np.random.default_rng(3)
    own, common = 1e-4 * rng.normal(size=(FRAMES, 60, 3)), rng.normal(size=(FRAMES, 1, 3))
    certain = np.ones((FRAMES, 60), bool)
    shaken, still = (LiftedTracks(xyz, certain, np.arange(60)) for xyz in (own + common, own))
    np.testing.assert_allclose(np.median(track_noise(shaken, TIMES)), np.median(track_noise(still, TIMES)), rtol=0.05)
    few = shaken.subset(np.arange(MIN_COMMON - 1))
    assert np.median(track_noise(few, TIMES)) > 1e3 * np.median(track_noise(still, TIMES))


def test_of_coinciding_tracks_each_seed_keeps_one():
    xyz = np.zeros((3, 12, 3), np.float32)
    xyz[:, 6:, 0] = 1
    same = LiftedTracks(xyz, np.ones((3, 12), bool), np.arange(12))
    found = choose_nodes(same, np.arange(3.0), -1.0, SelectionConfig(counts=(2, 4), tracks_per_node=1.0))
    assert [row.nodes for row in found.table] == [2], "no curve is apart from two that stand for all"
    assert found.unit == 1e-4, "and a unit is never nothing"
