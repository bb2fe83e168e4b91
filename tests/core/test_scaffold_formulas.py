"""Lifting, node control, joining and the geometric optimisation, each step beside loops or a small case worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.control import densify_nodes, largest_weights, prune_nodes
from f4x_core.scaffold.distance import curve_distance
from f4x_core.scaffold.graph import GraphConfig, build_graph, multilevel_edges
from f4x_core.scaffold.lifting import LiftingConfig, _outliers, _shaking, complete_curves, lift_tracks
from f4x_core.scaffold.losses import ArapEdges, arap_losses, smoothness_losses
from f4x_core.scaffold.optimise import GeometryConfig, Sightlines, optimise_geometry
from f4x_core.windows.joining import continue_nodes, join_scaffolds

# ---- lifting ---------------------------------------------------------------------------------------------------------


def carried_on(xyz: np.ndarray, certain: np.ndarray, carriers: int) -> tuple[np.ndarray, np.ndarray]:
    """Curve by curve from the last certain sample on, and how many frames ago that was (infinite: never)."""
    frames, number = certain.shape
    placed, ago = xyz.copy(), np.where(certain, 0.0, np.inf)
    for f in range(1, frames):
        for i in range(number):
            if certain[f, i] or np.isinf(ago[f - 1, i]):
                continue
            ago[f, i] = ago[f - 1, i] + 1
            placed[f, i] = placed[f - 1, i]
            seen = [j for j in range(number) if certain[f, j] and certain[f - 1, j]]
            near = sorted(seen, key=lambda j: np.linalg.norm(xyz[f - 1, j] - placed[f - 1, i]))[:carriers]
            if near:
                weights = [1 / ((xyz[f - 1, j] - placed[f - 1, i]) ** 2).sum() for j in near]
                steps = [w * (xyz[f, j] - xyz[f - 1, j]) for w, j in zip(weights, near, strict=True)]
                placed[f, i] += np.sum(steps, 0) / sum(weights)
    return placed, ago


@pytest.mark.parametrize("carriers", [1, 3, 20])
def test_gaps_are_carried_from_both_ends_and_blended_in_time(carriers):
    rng = np.random.default_rng(0)
    times = np.array([0.0, 1, 2.5, 3, 5, 6, 8, 9, 9.5])
    xyz = rng.normal(size=(1, 8, 3)) + 0.3 * rng.normal(size=(9, 8, 3)).cumsum(0)
    certain = rng.random((9, 8)) < 0.6
    certain[:, 7], certain[4:6, :7] = False, False  # a curve never seen, and a step that none was seen to make
    found = complete_curves(xyz, certain, times, carriers)
    ahead, since = carried_on(xyz, certain, carriers)
    behind, until = (part[::-1] for part in carried_on(xyz[::-1], certain[::-1], carriers))
    for f in range(9):
        for i in range(8):
            wanted = xyz[f, i]
            if certain[:, i].any() and not certain[f, i]:
                if np.isinf(since[f, i]):
                    wanted = behind[f, i]
                elif np.isinf(until[f, i]):
                    wanted = ahead[f, i]
                else:
                    start, end = times[f - int(since[f, i])], times[f + int(until[f, i])]
                    share = (times[f] - start) / (end - start)
                    wanted = (1 - share) * ahead[f, i] + share * behind[f, i]
            np.testing.assert_allclose(found[f, i], wanted, atol=1e-9)


def test_a_curve_on_another_moves_as_that_one():
    xyz = np.zeros((3, 3, 3))
    xyz[:, 0, 0], xyz[:, 1] = [0, 1, 2], [0, 0, 1e-2]
    certain = np.ones((3, 3), bool)
    certain[1:, 2] = False
    own, other = 1 / np.finfo(np.float32).eps, 1 / 1e-2**2  # a distance of 0 is taken for rounding
    found = complete_curves(xyz, certain, np.arange(3.0), 2)[1, 2, 0]
    np.testing.assert_allclose(found, own / (own + other), rtol=1e-6)


def test_outliers_are_far_from_their_neighbours_by_standard_deviations():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 3)) * rng.uniform(0.5, 3, (30, 1))
    means = []
    for i in range(30):
        others = sorted(np.linalg.norm(points[i] - points[j]) for j in range(30) if j != i)
        means.append(np.mean(others[:4]))
    for ratio in (0.5, 1.5, 2.5):
        config = LiftingConfig(outlier_neighbours=4, outlier_ratio=ratio)
        wanted = [mean > np.mean(means) + ratio * np.std(means) for mean in means]
        assert _outliers(points, config).tolist() == wanted and 0 < sum(wanted) < 15
    assert not _outliers(points[:4], LiftingConfig(outlier_neighbours=4, outlier_ratio=0.0)).any(), "too few to say"
    assert _outliers(points[:5], LiftingConfig(outlier_neighbours=4, outlier_ratio=0.0)).any()
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    assert not _outliers(ring, LiftingConfig(outlier_neighbours=2, outlier_ratio=0.0)).any(), (
        "all alike but for rounding"
    )


def test_shaking_is_the_distance_from_the_line_between_both_neighbours_in_time():
    times = np.array([0.0, 1, 3, 4, 8])
    xyz = np.random.default_rng(2).normal(size=(5, 6, 3))
    off = np.zeros((5, 6))
    for i in range(6):
        off[0, i], off[4, i] = np.linalg.norm(xyz[1, i] - xyz[0, i]), np.linalg.norm(xyz[4, i] - xyz[3, i])
        for f in (1, 2, 3):
            share = (times[f] - times[f - 1]) / (times[f + 1] - times[f - 1])
            off[f, i] = np.linalg.norm(xyz[f, i] - (1 - share) * xyz[f - 1, i] - share * xyz[f + 1, i])
    for threshold in np.quantile(off, [0.2, 0.5, 0.8]):
        np.testing.assert_array_equal(_shaking(xyz, times, threshold), off >= threshold)
    line = np.arange(3.0)[:, None, None] * np.array([0.5, 0, 0])
    assert _shaking(line, np.arange(3.0), 0.5)[:, 0].tolist() == [True, False, True], "half is not less than half"
    bump = np.array([0, 0.5, 0])[:, None, None] * np.array([1.0, 0, 0])
    assert _shaking(bump, np.arange(3.0), 0.5)[:, 0].tolist() == [True] * 3
    assert _shaking(line[:2], np.arange(2.0), 0.4).all() and not _shaking(line[:1], np.arange(1.0), 0.0).any()


def test_what_is_believed_of_a_track():
    lens = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])
    path = CameraPath(np.tile(lens, (7, 1, 1)), np.tile(np.eye(4), (7, 1, 1)), np.arange(7.0), 32, 24)
    tracks = np.tile([[2.5, 2.5], [10.5, 4.5], [20.5, 8.5], [28.5, 20.5]], (7, 1, 1))
    depth, seen = np.full((7, 24, 32), 2.0), np.ones((7, 4), bool)
    depth[:, 4, 10] = 0  # no depth
    depth[:, 8, 20] = -1
    allowed = np.ones(depth.shape, bool)
    allowed[:3, 20, 28] = False
    seen[2, 0] = seen[2, 3] = False

    def kept(which=None, **changes):
        config = LiftingConfig(search_px=0, **changes)
        return lift_tracks(
            tracks, seen, depth if which is None else np.where(which, depth, np.nan), path, path.times, config
        )

    assert kept().index.tolist() == [0, 3] and kept(allowed).certain.sum(0).tolist() == [6, 4]
    np.testing.assert_allclose(kept().xyz[4], [[-13.5 / 15, -9.5 / 15, 2], [12.5 / 15, 8.5 / 15, 2]], rtol=1e-6)
    assert kept(allowed, min_samples=4).index.tolist() == [0, 3] and kept(allowed, min_samples=5).index.tolist() == [0]
    assert kept(allowed, min_samples=60).index.tolist() == [], "all seven at most"
    assert kept(allowed, min_fraction=0.58).index.tolist() == [0], "five of seven"
    assert kept(allowed, min_fraction=0.57).index.tolist() == [0, 3], "four"


# ---- nodes come and go -----------------------------------------------------------------------------------------------


def row_of_nodes(x: list[float], frames: int = 3, slots: int = 3, unit: float = 1.0) -> Scaffold:
    """Nodes on the x axis at rest, joined within two units."""
    xyz = np.zeros((frames, len(x), 3), np.float32)
    xyz[:, :, 0] = x
    neighbours, mask = build_graph(curve_distance(xyz), slots, 2.0)
    return Scaffold(
        times=np.arange(float(frames)),
        xyz=xyz,
        quat=np.tile(quaternion.IDENTITY, (frames, len(x), 1)).astype(np.float32),
        radius=np.linspace(0.1, 0.2, len(x), dtype=np.float32),
        certain=np.ones((frames, len(x)), bool),
        ids=10 + np.arange(len(x)),
        neighbours=neighbours,
        edge_mask=mask,
        unit=unit,
    )


def test_new_nodes_are_thinned_and_joined_to_the_nearest_old_and_new():
    old = row_of_nodes([0.0, 1.0])
    xyz = np.zeros((3, 4, 3))
    xyz[:, :, 0] = [1.5, 2.5, 2.9, 7.0]  # the second is no farther than a unit from the first
    quat = np.tile(-quaternion.IDENTITY, (3, 4, 1))
    quat[1] *= -1
    made, taken = densify_nodes(old, xyz, quat, 0.7, next_id=50, reach=2.5)
    assert taken.tolist() == [0, 2, 3] and made.ids.tolist() == [10, 11, 50, 51, 52]
    np.testing.assert_allclose(made.radius, [0.1, 0.2, 0.7, 0.7, 0.7], rtol=1e-6)
    assert made.certain[:, :2].all() and not made.certain[:, 2:].any()
    assert made.neighbours[2:].tolist() == [[2, 1, 3], [3, 2, 1], [4, 3, 2]]
    assert made.edge_mask[2:].tolist() == [[True, True, True], [True, True, True], [True, False, False]]
    np.testing.assert_array_equal(made.neighbours[:2], old.neighbours)
    np.testing.assert_array_equal(made.edge_mask[:2], old.edge_mask)
    np.testing.assert_array_equal(made.xyz[:, 2:, 0], np.tile([1.5, 2.9, 7.0], (3, 1)).astype(np.float32))
    assert (made.quat[:, 2:] == -quaternion.IDENTITY).all(), "the same turn in the same sign at all times"
    exact, _ = densify_nodes(old, xyz[:, :1] + [2.0, 0, 0], quat[:, :1], 0.7, 50, reach=2.5)
    assert exact.edge_mask[2].tolist() == [True, False, False], "2.5 units are not below 2.5"
    wide, _ = densify_nodes(row_of_nodes([0.0], slots=5), xyz[:, 3:], quat[:, 3:], 0.7, 50)
    assert wide.neighbours[1].tolist() == [1, 0, 1, 1, 1] and wide.edge_mask[1].tolist() == [True, *[False] * 4]
    assert densify_nodes(row_of_nodes([2.5]), xyz[:, 3:], quat[:, 3:], 0.7, 50)[0].edge_mask[1, 1], "five units reach"


def test_nodes_that_weigh_too_little_go_unless_gaussians_hang_on_them():
    old = row_of_nodes([0.0, 1, 2, 3, 4])
    greatest = np.array([0.5, 0.019, 0.02, 0.0, 0.3])
    made, new = prune_nodes(old, greatest, np.array([3]))
    assert new.tolist() == [0, -1, 1, 2, 3] and made.ids.tolist() == [10, 12, 13, 14]
    assert made.neighbours.tolist() == [[0, 0, 1], [1, 1, 2], [2, 1, 3], [3, 2, 1]]
    mask = np.array([[1, 0, 0], [1, 0, 1], [1, 1, 1], [1, 1, 0]], bool)
    np.testing.assert_array_equal(made.edge_mask, mask)
    np.testing.assert_array_equal(made.radius, old.radius[[0, 2, 3, 4]])
    weights = np.array([[0.2, 0.7], [0.6, 0.1]])
    assert largest_weights(np.array([[0, 2], [2, 0]]), weights, 4).tolist() == [0.2, 0, 0.7, 0]
    with pytest.raises(F4xError, match="one weight per node"):
        prune_nodes(old, np.zeros(3), np.array([3]))


# ---- windows are joined ------------------------------------------------------------------------------------------------


def shifted(later: Scaffold, by: np.ndarray, turn: float = 0.0) -> Scaffold:
    """The nodes after three frames, moved as if by noise: there and back (S,), and turned about z."""
    turned = quaternion.from_rotation_vector(turn * np.outer(by, [0, 0, 1.0]))[:, None]
    xyz = later.xyz + (by[:, None, None] * np.array([0, 1.0, 0])).astype(np.float32)
    quat = quaternion.multiply(np.broadcast_to(turned, later.quat.shape), later.quat.astype(float))
    return replace(later, xyz=xyz if turn == 0 else later.xyz, quat=quat.astype(np.float32))


@pytest.mark.parametrize(
    ("turn", "tolerance", "goes_on"),
    [(0.0, 0.051, True), (0.0, 0.049, False), (0.4, 0.0405, True), (0.4, 0.0395, False)],
)
def test_nodes_go_on_where_their_poses_differ_by_no_more_than_the_tolerance(turn, tolerance, goes_on):
    """A shift there and back by 0.05; or turns of 0.4 times that about z, each worth what it moves two units away."""
    before = row_of_nodes([0.0, 5.0], frames=4, unit=2.0)
    by = 0.05 * np.array([1.0, -1, 1, -1])
    after = replace(shifted(before, by, turn), ids=np.array([0, 1]), times=before.times)
    found = continue_nodes(after, before, tolerance, 70)
    assert found.ids.tolist() == ([10, 11] if goes_on else [70, 71])


def test_of_several_candidates_the_best_pair_goes_on_and_each_node_once():
    before = replace(row_of_nodes([0.0, 0.5], frames=4), ids=np.array([0, 1]))
    wobble = np.array([1.0, -1, 1, -1])[:, None, None] * np.array([[0, 0.02, 0], [0, 0.01, 0], [0, 0.03, 0]])
    after = row_of_nodes([0.0, 0.5, 1.4], frames=4)
    after = replace(after, xyz=(after.xyz + wobble).astype(np.float32))
    found = continue_nodes(after, before, 0.05, 70)
    assert sorted(found.ids.tolist()) == [0, 1, 70] and found.ids[2] == 70, "the two that wobble least"
    far = continue_nodes(replace(after, xyz=after.xyz + np.float32(1.6)), before, 0.05, 70)
    assert far.ids.tolist() == [70, 71, 72], "all are a unit apart or more"


def test_a_part_keeps_its_slots_and_the_unit_is_the_middle_one():
    """Where shares fade the poses are their means; padding points to the node itself and is no edge."""
    first, second = row_of_nodes([0.0, 1.0], frames=5, slots=2), row_of_nodes([1.0, 2.0, 3.0], frames=5, slots=3)
    second = replace(second, ids=np.array([11, 12, 13]), times=second.times + 3, unit=3.0)
    second.xyz[..., 1] = 0.4
    second.certain[:2, 0] = False  # there the first part saw it
    spans = np.array([[-1.0, 0, 3, 5], [3.0, 5, 8, 9]])
    whole, rows = join_scaffolds([first, second], spans)
    assert whole.unit == 2.0 and [row.tolist() for row in rows] == [[0, 1], [1, 2, 3]]
    assert whole.neighbours.tolist() == [[0, 1, 0], [1, 0, 1], [2, 1, 3], [3, 2, 1]]
    assert whole.edge_mask.tolist() == [[True, True, False], [True, True, False], [True] * 3, [True, True, False]]
    np.testing.assert_allclose(whole.xyz[:, 1, 1], [0, 0, 0, 0, 0.2, 0.4, 0.4, 0.4], atol=1e-5)
    np.testing.assert_allclose(whole.xyz[:, 0, 0], 0, atol=1e-6)
    np.testing.assert_allclose(whole.xyz[:, 3, 0], 3, atol=1e-5)
    assert whole.certain[:, 0].tolist() == [True] * 5 + [False] * 3 and whole.certain[:, 1].all()
    np.testing.assert_allclose(whole.quat, np.tile(quaternion.IDENTITY, (8, 4, 1)), atol=1e-6)


def test_a_turn_that_two_parts_see_differently_is_the_middle_one_whatever_its_sign():
    part = row_of_nodes([0.0], frames=3)
    turns = [quaternion.from_rotation_vector(np.array([angle, 0, 0])) for angle in (0.2, 0.6, 0.4)]
    parts = [
        replace(part, quat=np.tile(sign * turn, (3, 1, 1)).astype(np.float32))
        for sign, turn in zip((1, -1), turns[:2], strict=True)
    ]
    whole, _ = join_scaffolds(parts, np.array([[-2.0, -1, 8, 9]] * 2))
    np.testing.assert_allclose(np.abs(whole.quat @ turns[2]), 1, atol=1e-6)


def test_signs_that_agree_along_the_graph_stay_and_others_follow_the_first_node():
    """Three nodes in a row and a lone one, turned by up to a radian; the second is stored in the other sign."""
    part = row_of_nodes([0.0, 1.0, 2.0, 9.0], frames=4)
    turns = quaternion.from_rotation_vector(np.random.default_rng(0).uniform(-0.6, 0.6, (4, 4, 3)))
    turns = quaternion.align_sequence(turns)
    stored = turns * np.array([1, -1, 1, 1])[:, None]
    whole, _ = join_scaffolds([replace(part, quat=stored.astype(np.float32))], np.array([[-2.0, -1, 8, 9]]))
    np.testing.assert_allclose(whole.quat, turns, atol=1e-6)
    np.testing.assert_allclose(whole.xyz, part.xyz, atol=1e-6)


# ---- the geometric optimisation --------------------------------------------------------------------------------------


def rough(frames: int, count: int) -> Scaffold:
    rng = np.random.default_rng(4)
    xyz = rng.normal(size=(1, count, 3)) + 0.05 * rng.normal(size=(frames, count, 3))
    quat = quaternion.normalize(quaternion.IDENTITY + 0.1 * rng.normal(size=(frames, count, 4)))
    neighbours, mask = build_graph(curve_distance(xyz), 4, 5.0)
    return Scaffold(
        times=np.cumsum(rng.uniform(0.5, 1.5, frames)),
        xyz=xyz.astype(np.float32),
        quat=quat.astype(np.float32),
        radius=np.full(count, 0.1, np.float32),
        certain=rng.random((frames, count)) < 0.7,
        ids=np.arange(count),
        neighbours=neighbours,
        edge_mask=mask,
        unit=0.4,
    )


def held_written_out(
    moved: torch.Tensor, scaffold: Scaffold, sight: Sightlines | None, config: GeometryConfig
) -> torch.Tensor:
    """Mean over observed places of `|across|^2 + stiffness |along|^2`, where along runs from the camera to the node."""
    total = torch.zeros(())
    for f, i in np.argwhere(scaffold.certain):
        step = moved[f, i]
        if sight is None:
            total = total + step @ step
            continue
        ray = torch.as_tensor(sight.direction[f, i], dtype=torch.float32)
        along = (step @ ray) * ray
        across, stiffness = step - along, config.along_ray ** (1 - min(max(float(sight.confidence[f, i]), 0), 1))
        total = total + across @ across + stiffness * along @ along
    return total / max(int(scaffold.certain.sum()), 1)


@pytest.mark.parametrize(
    ("certain", "sight", "window", "seen"),
    [
        ("soft", False, 5, 63),
        ("soft", True, 5, 63),
        ("hard", False, 5, 63),
        ("soft", False, 20, 63),
        ("soft", False, 5, 1),
    ],
)
def test_steps_are_adams_on_the_weighted_sum_of_the_losses(certain, sight, window, seen, one_thread):
    """Windows of five of nine frames at random, or all of them, coarse edges drawn anew every third step, a rate that falls
    along a cosine; 70 % of the places were observed, or one."""
    scaffold = rough(9, 7)
    scaffold.certain.flat[np.flatnonzero(scaffold.certain)[seen:]] = False
    rng = np.random.default_rng(5)
    rays = rng.normal(size=(9, 7, 3))
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)
    lines = Sightlines(rays, rng.uniform(-0.2, 1.2, (9, 7)).astype(np.float32)) if sight else None
    config = GeometryConfig(
        steps=7, learning_rate=0.02, decay_start=0.3, decay_to=0.1, coordinate=0.7, length=1.3, velocity=0.2,
        acceleration=0.4, angular_velocity=0.15, angular_acceleration=0.25, shifts=(1, 2), shift_weights=(0.6, 0.4),
        certain=certain, certain_weight=3.0, window=window, redraw=3, seed=6,
        graph=GraphConfig(neighbours=4, reach=4.0, base_weight=0.6, levels=((2.0, 2, 0.5),)),
    )  # fmt: skip
    message = []
    found = optimise_geometry(scaffold, config, lambda *said: message.append(said[1:3]), lines)
    assert message == [(1, 7), (7, 7)]

    start = torch.as_tensor(scaffold.xyz)
    xyz, quat = start.clone().requires_grad_(), torch.as_tensor(scaffold.quat).clone().requires_grad_()
    both = scaffold.certain[:, :, None] & scaffold.certain[:, None]
    apart = np.linalg.norm(scaffold.xyz[:, :, None] - scaffold.xyz[:, None], axis=-1)
    distance = np.where(both.any(0), np.where(both, apart, 0).max(0), np.inf)
    np.fill_diagonal(distance, 0)
    neighbours, mask = build_graph(distance, 4, 4.0 * 0.4)
    adam, windows = torch.optim.Adam([xyz, quat], eps=1e-15), np.random.default_rng(6)
    certain_too = torch.as_tensor(scaffold.certain)[..., None]
    for step in range(7):
        if step in (0, 3, 6):
            levels = multilevel_edges(distance, 0.4, config.graph, 6 + step)
            edges = ArapEdges.build(neighbours, mask, 0.6, levels)
        passed = max(step / 7 - 0.3, 0) / 0.7
        for group in adam.param_groups:
            group["lr"] = 0.02 * (0.1 + 0.9 * (1 + np.cos(np.pi * passed)) / 2)
        first = int(windows.integers(0, 5)) if window == 5 else 0
        here = slice(first, first + window)
        x = torch.where(certain_too, start, xyz) if certain == "hard" else xyz
        unit = quaternion.normalize(quat[here])
        coordinate, length = arap_losses(x[here], unit, edges, (1, 2), (0.6, 0.4))
        smooth = smoothness_losses(x[here], unit, torch.as_tensor(scaffold.times)[here])
        terms = [coordinate, length, *smooth]
        loss = sum(weight * term for weight, term in zip((0.7, 1.3, 0.2, 0.4, 0.15, 0.25), terms, strict=True))
        if certain == "soft":
            loss = loss + 3.0 * held_written_out(xyz - start, scaffold, lines, config)
        adam.zero_grad()
        loss.backward()
        adam.step()
    wanted = torch.where(certain_too, start, xyz) if certain == "hard" else xyz
    np.testing.assert_allclose(found.xyz, wanted.detach().numpy(), atol=2e-4)
    unit = quaternion.normalize(quat.detach()).numpy()
    np.testing.assert_allclose(np.abs((found.quat * unit).sum(-1)), 1, atol=1e-5)
    graph = build_graph(curve_distance(found.xyz), 4, 4.0 * 0.4)
    np.testing.assert_array_equal(found.neighbours, graph[0])
    np.testing.assert_array_equal(found.edge_mask, graph[1])


def test_without_steps_or_a_second_frame_or_node_nothing_changes():
    for scaffold, steps in ((rough(4, 4), 0), (rough(1, 4), 5), (rough(4, 1), 5)):
        assert optimise_geometry(scaffold, GeometryConfig(steps=steps)) is scaffold
