"""Groups of nodes: the greedy merging, the choice of their number and what stays unexplained, beside plain forms."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from f4x_core.geometry import quaternion
from f4x_core.scaffold.groups import _medoids, connected_groups, nonrigidity, rigid_groups, shape_change


def turned_onto(first: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Shapes (F,n,3) about their middles, turned back onto that of the first time by the best rotation."""
    centred = xyz - xyz.mean(1, keepdims=True)
    if xyz.shape[1] < 3:
        return centred
    start = first - first.mean(0)
    return np.stack([Rotation.align_vectors(start, shape)[0].apply(shape) for shape in centred])


def unexplained(xyz: np.ndarray) -> float:
    """Sum of squares that the best rigid motion and the mean shape leave of curves (F,n,3)."""
    shape = turned_onto(xyz[0], xyz)
    return float(((shape - shape.mean(0)) ** 2).sum())


def merged_written_out(xyz: np.ndarray, parts: list[list[int]]) -> list[tuple[float, list[tuple[int, ...]]]]:
    """All numbers of groups: of every two the pair is merged whose residual grows least."""

    @cache
    def left(part: tuple[int, ...]) -> float:
        return unexplained(xyz[:, part])

    now = [tuple(part) for part in parts]
    splits = [(sum(map(left, now)), now)]
    while len(now) > 1:
        growth = {(a, b): left(a + b) - left(a) - left(b) for a, b in combinations(now, 2)}
        a, b = min(growth, key=growth.__getitem__)
        now = [part for part in now if part not in (a, b)] + [a + b]
        splits.append((sum(map(left, now)), now))
    return splits


def as_sets(group: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(group == number).tolist()) for number in np.unique(group)}


def bodies(noise: float, seed: int = 0) -> np.ndarray:
    """Three bodies of 5, 4 and 3 nodes that turn about axes of their own: curves (9,12,3)."""
    rng = np.random.default_rng(seed)
    parts = []
    for count, place, axis in ((5, 0.0, [0, 0, 1.0]), (4, 3.0, [0, 1.0, 0]), (3, 6.0, [1.0, 0, 0])):
        rest = rng.uniform(-0.5, 0.5, (count, 3))
        turn = quaternion.from_rotation_vector(0.15 * np.arange(9.0)[:, None, None] * np.array([[axis]]))
        parts.append(quaternion.rotate(turn, rest) + np.array([place, 0, 0]))
    xyz = np.concatenate(parts, 1)
    return xyz + noise * rng.normal(size=xyz.shape)


@pytest.mark.parametrize(("noise", "seed"), [(0.02, 0), (0.1, 1), (0.3, 2), (0.0, 3)])
def test_as_many_groups_as_schwarz_favours(noise, seed):
    """12 nodes begin as 12 groups; -2 log likelihood of Gaussian residuals and log(n) for each of 6 numbers a time and group."""
    xyz = bodies(noise, seed)
    splits = merged_written_out(xyz, [[node] for node in range(12)])
    values = 3 * 9 * 12
    floor = 9 * 12 * (1e-6 * np.ptp(xyz)) ** 2
    costs = [values * np.log(left + floor) + 6 * 9 * len(parts) * np.log(values) for left, parts in splits]
    parts = splits[int(np.argmin(costs))][1]
    found = rigid_groups(xyz)
    assert as_sets(found) == {frozenset(part) for part in parts}
    sizes = np.bincount(found)
    assert (np.diff(sizes) <= 0).all() and sizes[0] == max(map(len, parts))
    for count in (1, 2, 5, 9) if noise else (1, 2):  # without noise rounding decides which nodes of a body meet first
        asked = next(parts for _, parts in splits if len(parts) == count)
        assert as_sets(rigid_groups(xyz, count)) == {frozenset(part) for part in asked}


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_groups_are_the_same_in_every_unit(unit):
    for noise in (0.0, 0.02):
        assert as_sets(rigid_groups(unit * bodies(noise))) == as_sets(rigid_groups(bodies(noise)))


def test_nodes_in_one_place_are_in_one_group():
    assert rigid_groups(np.zeros((5, 4, 3))).tolist() == [0, 0, 0, 0]
    twice = np.concatenate([bodies(0.02), bodies(0.02)[:, 8:10]], 1)
    found = rigid_groups(twice)
    assert found[12:].tolist() == found[8:10].tolist()


def test_twelve_times_are_looked_at():
    """Bodies that part between those are one: the rounded twelve of 45 times are 0, 4, 8, ... 44."""
    xyz = np.repeat(bodies(0.0)[:1], 45, 0)
    between = xyz.copy()
    between[[1, 2, 3, 21, 43], 5:] += 1.0
    assert rigid_groups(between).max() == 0
    there = xyz.copy()
    there[24, 5:, 1] += 1.0
    there[44, 9:, 2] += 1.0
    assert as_sets(rigid_groups(there)) == {frozenset(range(5)), frozenset(range(5, 9)), frozenset(range(9, 12))}


def test_nodes_are_as_far_from_rigid_as_their_distance_changes():
    xyz = np.random.default_rng(1).normal(size=(6, 5, 3))
    found = nonrigidity(xyz)
    for i in range(5):
        for j in range(5):
            distance = [np.linalg.norm(frame[i] - frame[j]) for frame in xyz]
            assert found[i, j] == pytest.approx(max(distance) - min(distance) + 0.05 * np.mean(distance), abs=1e-12)


def test_medoids_are_the_middles_of_what_is_nearest_to_them():
    """From the middle of all, the farthest each time; then the middle of each group until nothing changes."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        places = rng.normal(size=(30, 2)) + 3 * rng.integers(0, 3, (30, 1))
        distance = np.linalg.norm(places[:, None] - places, axis=-1)
        medoids = [min(range(30), key=lambda i: distance[i].sum())]
        while len(medoids) < 4:
            medoids.append(max(range(30), key=lambda i: min(distance[i, m] for m in medoids)))
        while True:
            group = [min(range(4), key=lambda g: distance[i, medoids[g]]) for i in range(30)]
            before, medoids = medoids, []
            for number in range(4):
                members = [i for i in range(30) if group[i] == number]
                medoids.append(min(members, key=lambda i: sum(distance[i, j] for j in members)))
            if medoids == before:
                break
        assert _medoids(distance, 4).tolist() == medoids


def test_what_edges_join_is_a_group_and_the_largest_comes_first():
    edges = np.array([[5, 6], [1, 2], [2, 4], [6, 0], [0, 7]])
    assert connected_groups(edges, 9).tolist() == [0, 1, 1, 2, 1, 0, 0, 0, 3]
    assert connected_groups(np.zeros((0, 2), int), 3).tolist() == [0, 1, 2]


def test_a_change_of_shape_is_what_a_rigid_motion_leaves_over_both_extents():
    rng = np.random.default_rng(3)
    xyz = rng.normal(size=(5, 7, 3)) * np.array([1.0, 2.0, 0.5, 1.0, 3.0])[:, None, None] + 4
    found, first = shape_change(xyz), xyz[0] - xyz[0].mean(0)
    for frame in range(5):
        shape = turned_onto(xyz[0], xyz[frame : frame + 1])[0]
        extents = np.sqrt((first**2).sum()) * np.sqrt((shape**2).sum())
        assert found[frame] == pytest.approx(np.sqrt(((shape - first) ** 2).sum() / extents), abs=1e-9)
    assert shape_change(np.zeros((3, 4, 3))).tolist() == [0, 0, 0]
    np.testing.assert_allclose(shape_change(1e-2 * xyz), found, atol=1e-9)
