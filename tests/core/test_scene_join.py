"""Scenes of overlapping windows become one: nodes go on, Gaussians come and go, nothing jumps where windows meet."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene
from people_scene import people_scene

from f4x_core.edit.apply import with_operations
from f4x_core.edit.bake import bake
from f4x_core.edit.operations import Freeze, Opacity
from f4x_core.edit.selects import All, Moving
from f4x_core.errors import F4xError
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.interpolation import presence
from f4x_core.progress import silent
from f4x_core.query.not_deleted import not_deleted
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet, read_scene, write_scene
from f4x_core.scene.model import faded
from f4x_core.scene.people import people_of
from f4x_core.windows.join import ALWAYS, _weights, _with_new_ground, join_scenes, spans_of
from f4x_core.windows.joining import continue_nodes, join_scaffolds

WIDTH, HEIGHT = 32, 20
WINDOWS = ((0, 10), (6, 16))


def body(times: np.ndarray, places: np.ndarray, turn: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Poses (F,M,3), (F,M,4) of points of one rigid body that turns and drifts; `turn` is the gauge of the nodes' own frames."""
    q = quaternion.from_rotation_vector(np.stack([0 * times, 0.05 * times, 0.02 * times], -1))[:, None]
    x = quaternion.rotate(q, places[None]) + np.stack([0.02 * times, 0 * times, 1 + 0 * times], -1)[:, None]
    own = quaternion.from_rotation_vector(np.array([turn, 0.0, 0.0]))
    return x, quaternion.multiply(np.broadcast_to(q, (*x.shape[:2], 4)), own)


def scaffold(times, places, ids, turn=0.0) -> Scaffold:
    x, q = body(np.asarray(times, float), places, turn)
    count = len(places)
    return Scaffold(
        times=np.asarray(times, np.float64),
        xyz=x.astype(np.float32),
        quat=q.astype(np.float32),
        radius=np.full(count, 0.1, np.float32),
        certain=np.ones((len(times), count), bool),
        ids=np.asarray(ids, np.int64),
        neighbours=np.stack([np.arange(count), (np.arange(count) + 1) % count], 1),
        edge_mask=np.ones((count, 2), bool),
        unit=0.2,
    )


def gaussians(ids, xyz) -> dict[str, np.ndarray]:
    count = len(ids)
    return {
        "ids": np.asarray(ids, np.int64),
        "means": np.asarray(xyz, np.float32),
        "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.full((count, 3), 0.05, np.float32),
        "opacities": np.full(count, 0.8, np.float32),
        "sh": np.full((count, 1, 3), 0.5, np.float32),
    }


def dynamic(nodes: Scaffold, first_id: int, reference) -> DynamicSet:
    """One Gaussian on each node, resting at the given rows of the scaffold's times."""
    count = len(nodes)
    reference = np.broadcast_to(np.asarray(reference, np.int32), count)
    return DynamicSet(
        **gaussians(first_id + np.arange(count), nodes.xyz[reference, np.arange(count)]),
        reference=reference.copy(),
        node=nodes.neighbours.astype(np.int32),
        weight=np.full((count, 2), 0.5, np.float32),
        strength=np.ones(count, np.float32),
    )


def cameras(frames: int) -> CameraPath:
    lens = np.array([[30.0, 0, WIDTH / 2], [0, 30.0, HEIGHT / 2], [0, 0, 1]])
    return CameraPath(
        np.tile(lens, (frames, 1, 1)), np.tile(np.eye(4), (frames, 1, 1)), np.arange(frames, dtype=float), WIDTH, HEIGHT
    )


PLACES = np.array([[-0.1, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])


def windows() -> list[Scene]:
    """Two windows of one body. The second keeps background 0, loses 1, adds 10 in sight and 11 outside every picture."""
    first, later = scaffold(range(10), PLACES, [0, 1, 2]), scaffold(range(6, 16), PLACES, [0, 1, 2], turn=0.3)
    later = continue_nodes(later, first, 0.01, 3)
    later = replace(later, times=later.times - 6)
    background = (
        gaussians([0, 1], [[0, 0, 2], [0.3, 0, 2]]),
        gaussians([0, 10, 11], [[0, 0, 2], [-0.3, 0, 2], [5, 0, 2]]),
    )
    parts = zip(background, (first, later), (2, 12), ([0, 5, 8], [1, 5, 8]), strict=True)
    return [
        Scene("clip", StaticSet(**static), cameras(10), dynamic(nodes, ids, reference), nodes, held_out=(3,))
        for static, nodes, ids, reference in parts
    ]


@pytest.fixture
def joined() -> Scene:
    return join_scenes(windows(), WINDOWS)


def test_windows_of_a_varying_frame_rate_join_at_their_times(joined):
    times = np.cumsum([0.0, *([0.5, 0.5, 2.0, 1.0, 0.25] * 3)])

    def timed(scene, start, end):
        own = times[start:end] - times[start]
        return replace(scene, cameras=replace(scene.cameras, times=own), scaffold=replace(scene.scaffold, times=own))

    parts = [timed(scene, *window) for scene, window in zip(windows(), WINDOWS, strict=True)]
    whole = join_scenes(parts, WINDOWS, times=times)
    assert np.array_equal(whole.cameras.times, times) and np.array_equal(whole.scaffold.times, times)
    assert np.array_equal(whole.dynamic.reference, joined.dynamic.reference)
    for frame in (0, 3, 5, 11, 15):
        assert np.allclose(whole.posed(times[frame]).means, joined.posed(frame).means, atol=1e-5)
    middle = (times[6] + times[9]) / 2
    assert sorted({*whole.dynamic.span.ravel()} - {np.inf, -np.inf}) == pytest.approx([middle - 0.5, middle + 0.5])


def test_presence_ramps_steps_and_infinities():
    span = np.array([[0, 4, 8, 10], [2, 2, 5, 5], [-np.inf, -np.inf, np.inf, np.inf]])
    table = np.array([presence(span, t) for t in (-1, 0, 1, 2, 5, 9, 10)])
    assert np.allclose(table[:, 0], [0, 0, 0.25, 0.5, 1, 0.5, 0])
    assert table[:, 1].tolist() == [0, 0, 0, 1, 0, 0, 0]
    assert (table[:, 2] == 1).all()


def test_two_halves_of_a_fade_are_as_opaque_as_one():
    opacity, share = np.float32([0.3, 0.9, 0.99]), np.float32([0.2, 0.5, 0.7])
    through = (1 - faded(opacity, share)) * (1 - faded(opacity, 1 - share))
    assert np.allclose(through, 1 - opacity, atol=1e-6)
    assert (faded(opacity, np.zeros(3, np.float32)) == 0).all() and (
        faded(opacity, np.ones(3, np.float32)) == opacity
    ).all()


def test_nodes_that_go_on_keep_their_ids_and_move_nothing():
    first = scaffold(range(10), PLACES, [4, 7, 9])
    other = np.array([[0.05, 0.03, 0.02], [-0.1, 0.02, 0.0], [3.0, 0, 0]])  # beside 7, beside 4, far away
    later = scaffold(range(6, 16), other, [0, 1, 2], turn=0.7)
    found = continue_nodes(later, first, 0.01, 20)
    assert found.ids[2] == 20 and set(found.ids[:2]) <= {4, 7, 9} and len(set(found.ids.tolist())) == 3
    for node in (0, 1):
        there = np.flatnonzero(first.ids == found.ids[node])[0]
        assert np.allclose(found.xyz[:4, node], first.xyz[6:, there], atol=1e-6)
    for t, r in ((9, 0), (3, 8)):  # Q(t) Q(r)^-1 is what carries Gaussians
        before, after = (pose.compose(s.quat[t], s.xyz[t], *pose.invert(s.quat[r], s.xyz[r])) for s in (later, found))
        assert np.allclose(before[1], after[1], atol=1e-5)
        assert np.allclose(quaternion.to_matrix(before[0]), quaternion.to_matrix(after[0]), atol=1e-5)


def test_nodes_that_move_otherwise_are_other_nodes():
    first, later = scaffold(range(10), PLACES, [0, 1, 2]), scaffold(range(6, 16), PLACES, [0, 1, 2])
    later = replace(later, xyz=later.xyz + np.float32(0.02) * np.arange(10, dtype=np.float32)[:, None, None])
    assert continue_nodes(later, first, 0.01, 3).ids.tolist() == [3, 4, 5]
    apart = replace(later, times=later.times + 100)
    assert continue_nodes(apart, first, 0.01, 3).ids.tolist() == [3, 4, 5]


def test_joined_scaffold_holds_nodes_still_where_their_windows_do_not_reach():
    first, later = scaffold(range(10), PLACES, [0, 1, 2]), scaffold(range(6, 16), PLACES, [1, 2, 5])
    whole, rows = join_scaffolds([first, later], spans_of(WINDOWS, np.arange(16.0)))
    assert whole.ids.tolist() == [0, 1, 2, 5] and [row.tolist() for row in rows] == [[0, 1, 2], [1, 2, 3]]
    assert (whole.xyz[9:, 0] == whole.xyz[9, 0]).all() and (whole.xyz[:7, 3] == whole.xyz[6, 3]).all()
    assert not whole.certain[12, 0] and whole.certain[12, 3]
    half = presence(spans_of(WINDOWS, np.arange(16.0)), 7.0)
    assert np.allclose(half.sum(), 1) and np.allclose(
        whole.xyz[7, 1], half[0] * first.xyz[7, 1] + half[1] * later.xyz[1, 0], atol=1e-6
    )


def test_a_rigid_body_moves_on_over_the_seam(joined):
    assert len(joined.cameras) == 16 and joined.held_out == (3, 9)
    assert len(joined.scaffold) == 3, "the nodes of the second window are those of the first"
    for time in (0.0, 5.0, 7.0, 7.5, 8.5, 12.0, 15.0):
        posed = joined.posed(time)
        expected, _ = body(np.array([time]), PLACES)
        here = posed.dynamic & (posed.opacities > 0)
        named = dict(zip(posed.ids[here].tolist(), posed.means[here], strict=True))
        for number, mean in named.items():
            # between knots the curve is not the body's; K = 2 nodes of one rigid body carry like one
            assert np.allclose(mean, expected[0, (number - 2) % 10], atol=2e-3), (time, number)


def test_windows_alone_are_what_they_were(joined):
    for scene, (start, _), frames in zip(windows(), WINDOWS, (range(6), range(10, 16)), strict=True):
        for frame in frames:
            alone, whole = scene.posed(frame - start), joined.posed(frame)
            row = {int(i): n for n, i in enumerate(whole.ids)}
            rows = [row[int(i)] for i in alone.ids]
            assert np.allclose(whole.means[rows], alone.means, atol=1e-5)
            assert np.allclose(whole.opacities[rows], alone.opacities)
            others = np.setdiff1d(np.arange(len(whole.ids)), rows)
            unseen = whole.ids[others] == 11
            assert (whole.opacities[others][~unseen] == 0).all()


def test_what_follows_nodes_of_its_own_window_rests_where_it_was_fitted(joined):
    """To rest elsewhere is lossy where nodes part, and needed only for nodes that two windows have."""
    first, later = windows()
    assert later.scaffold is not None and joined.scaffold is not None
    own = replace(later, scaffold=replace(later.scaffold, ids=later.scaffold.ids + 100), next_id=200)
    apart = join_scenes([first, own], WINDOWS)
    assert apart.scaffold is not None
    rests = apart.scaffold.times[apart.dynamic.reference]
    assert rests.tolist() == [0, 5, 8, 7, 11, 14]
    assert joined.scaffold.times[joined.dynamic.reference].tolist() == [0, 5, 5, 10, 11, 14], "these belong to both"


def test_background_comes_goes_or_was_always_there(joined):
    spans = dict(zip(joined.static.ids.tolist(), joined.static.span.tolist(), strict=True))
    inf = np.inf
    assert spans[0] == [-inf, -inf, inf, inf]
    assert spans[1] == [-inf, -inf, 7, 8], "amid the four frames that both share"
    assert spans[10] == [7, 8, inf, inf]
    assert spans[11] == [-inf, -inf, inf, inf], "no earlier frame shows it"


def test_what_movers_hid_before_was_there_from_the_beginning():
    """Of a wall that came at frame 3 no earlier frame shows what the square stood before, though its edges let some through."""
    scene = labelled_scene(features=False)
    x, y = scene.static.means[:, 0], scene.static.means[:, 1]
    hidden, open_ = (x > -0.26) & (x < -0.14) & (abs(y) < 0.12), (x > 0.1) & (x < 0.3) & (abs(y) < 0.12)
    span = np.tile(np.float32(ALWAYS), (len(x), 1))
    span[hidden | open_, :2] = 3
    came = replace(scene, static=replace(scene.static, span=span))
    assert (_weights(scene, 0.0, "auto")[: len(x)][hidden] > 0).any()
    found = _with_new_ground(came, np.zeros(len(x), bool), [0.0, 2.0], "auto", silent).static.span
    assert np.isneginf(found[hidden, :2]).all() and (found[open_, :2] == 3).all()


def test_what_nobody_had_looked_at_was_there_from_the_beginning_unless_it_was_known_in_another_form():
    scene = labelled_scene(features=False)
    beside = scene.static.means + np.float32([30, 0, 0])
    span = np.tile(np.float32([3, 3, np.inf, np.inf]), (len(beside), 1))
    came = replace(scene, static=replace(scene.static, means=beside, span=span))
    goes_on = np.arange(len(beside)) % 2 == 0
    found = _with_new_ground(came, goes_on, [0.0, 2.0], "auto", silent).static.span
    assert np.isneginf(found[~goes_on, :2]).all() and (found[goes_on, :2] == 3).all()


def test_what_a_window_painted_behind_movers_and_a_later_one_did_away_with_is_left_out():
    """Of a wall that goes at frame 3, what the square hides in frames 0 and 2 was never in sight; what lies beside it was."""
    scene = labelled_scene(features=False)
    x, y = scene.static.means[:, 0], scene.static.means[:, 1]
    hidden, open_ = (x > -0.26) & (x < -0.14) & (abs(y) < 0.12), (x > 0.1) & (x < 0.3) & (abs(y) < 0.12)
    span = np.tile(np.float32(ALWAYS), (len(x), 1))
    span[hidden | open_, 2:] = 3
    went = replace(scene, static=replace(scene.static, span=span))
    nobody = np.zeros(len(x), bool)
    found = _with_new_ground(went, nobody, [0.0, 2.0], "auto", silent).static
    np.testing.assert_array_equal(found.ids, scene.static.ids[~hidden])
    np.testing.assert_array_equal(found.span, span[~hidden])
    found = _with_new_ground(went, nobody, [4.0], "auto", silent).static
    assert len(found) == len(scene.static), "no frame tells of it while it is there"


def test_file_of_what_comes_and_goes(joined, tmp_path):
    write_scene(joined, tmp_path / "a.f4x")
    again = read_scene(tmp_path / "a.f4x")
    assert np.array_equal(again.static.span, joined.static.span)
    assert np.array_equal(again.dynamic.span, joined.dynamic.span)
    for time in (3.0, 7.5):
        shown = joined.posed(time).arrays()
        for name, array in again.posed(time).arrays().items():
            assert np.array_equal(array, shown[name])


def test_lifetimes_end_where_a_window_or_they_themselves_do():
    scenes = list(windows())
    own = np.float32([[-np.inf, -np.inf, 1, 2], [1, 2, np.inf, np.inf]])
    spans = [own[np.arange(len(scene.dynamic)) % 2] for scene in scenes]
    short = [
        replace(scene, dynamic=replace(scene.dynamic, span=span)) for scene, span in zip(scenes, spans, strict=True)
    ]
    alone, joined = join_scenes(scenes, WINDOWS), join_scenes(short, WINDOWS)
    starts = np.repeat([start for start, _ in WINDOWS], [len(scene.dynamic) for scene in scenes])
    both = np.concatenate(spans) + starts[:, None]
    for time in np.linspace(0, 16, 33):
        there = np.minimum(alone.dynamic.presence(time), presence(both, time))
        np.testing.assert_allclose(joined.dynamic.presence(time) > 0, there > 0)
    np.testing.assert_array_equal(joined.posed(9.0).means, alone.posed(9.0).means)  # carried where they are absent, too


@pytest.mark.parametrize("span", [[[3, 2, 5, 6]], [[np.nan, 2, 5, 6]], [[1, 2, 3]]])
def test_wrong_spans_are_refused(span):
    with pytest.raises(F4xError, match="span"):
        StaticSet(**gaussians([0], [[0, 0, 1]]), span=np.float32(span))


def test_windows_of_other_clips_are_refused():
    with pytest.raises(F4xError, match="not the windows"):
        join_scenes(windows(), ((0, 10), (6, 17)))


def test_edits_keep_when_gaussians_are_there(joined):
    fainter = with_operations(joined, Opacity(All(), 0.5))
    for time in (2.0, 7.25, 14.0):
        share = joined.presence(time)
        assert np.allclose(fainter.posed(time).opacities, faded(np.float32(0.4) + 0 * share, share), atol=1e-6)
    frozen = with_operations(joined, Freeze(Moving(), 2))
    assert np.allclose(frozen.posed(14.0).opacities[frozen.moving], joined.posed(2.0).opacities[joined.moving])
    assert not_deleted(fainter).all()


def test_baking_keeps_when_gaussians_are_there(joined):
    baked = bake(with_operations(joined, Opacity(All(), 0.5)))
    assert not baked.edits
    for time in (2.0, 7.25, 14.0):
        there, here = with_operations(joined, Opacity(All(), 0.5)).posed(time), baked.posed(time)
        assert np.array_equal(there.ids, here.ids)
        assert np.allclose(there.opacities, here.opacities, atol=1e-6)


def test_people_keep_one_number_and_their_limbs_through_windows():
    """The second window counts the two people the other way round, and sees a third one whom the first did not know."""
    one, two = people_scene(2, False), people_scene(3, False, order=(1, 0, 2), since=3, first_id=2000)
    whole = join_scenes([one, two], ((0, 6), (3, 9)))
    people = people_of(whole)
    node = np.concatenate([np.full(len(whole.static), -1), whole.dynamic.node[:, 0]])
    columns = [np.flatnonzero(whole.scaffold.ids[node] * (node >= 0) - (node < 0) == n) for n in range(3)]
    assert [np.unique(people.person[rows]).tolist() for rows in columns] == [[1], [2], [3]]
    assert all(
        np.bincount(people.part[rows])[1:].tolist() == [12 * (1 + (n < 2))] * 10 for n, rows in enumerate(columns)
    )


def test_windows_without_people_join_to_a_scene_without_and_those_who_come_later_are_counted_on():
    none, one = people_scene(0, False), people_scene(1, False, since=3, first_id=2000)
    assert people_of(join_scenes([none, people_scene(0, False)], ((0, 6), (3, 9)))) is None
    assert np.unique(people_of(join_scenes([none, one], ((0, 6), (3, 9)))).person).tolist() == [0, 1]
