"""Grabbing nodes: as rigid as possible, against a general minimiser; groups of nodes that move as one."""

import numpy as np
import pytest
from scipy.optimize import minimize

from f4x_core.geometry import pose, quaternion
from f4x_core.scaffold.grab import add_offset, grab, within_reach
from f4x_core.scaffold.groups import group_motion, nonrigidity, rigid_groups


def sheet(rows=5, columns=4) -> tuple[np.ndarray, np.ndarray]:
    """A slightly bumpy grid of nodes (M,3) and its edges (E,2), diagonals too."""
    index = np.arange(rows * columns).reshape(rows, columns)
    random = np.random.default_rng(0)
    xyz = np.stack([*np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")], -1).reshape(-1, 2).astype(float)
    xyz = np.concatenate([xyz, 0.2 * random.normal(size=(len(xyz), 1))], 1)
    pairs = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:-1, :-1], index[1:, 1:])]
    return xyz, np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in pairs])


XYZ, EDGES = sheet()


def stiffness(xyz: np.ndarray, edges: np.ndarray, placed: np.ndarray) -> float:
    """The energy that `grab` minimises, of nodes that went from `xyz (M,3)` to `placed (M,3)`."""
    both = np.concatenate([edges, edges[:, ::-1]])
    before, after = (points[both[:, 1]] - points[both[:, 0]] for points in (xyz, placed))
    moments = np.zeros((len(xyz), 3, 3))
    np.add.at(moments, both[:, 0], after[:, :, None] * before[:, None, :])
    u, _, vt = np.linalg.svd(moments)
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    return float(((after - np.einsum("eij,ej->ei", (u @ vt)[both[:, 0]], before)) ** 2).sum())


def test_a_rigid_pull_turns_the_whole():
    """Three grabbed nodes say where a rigid thing is; all others follow exactly, and nothing resists."""
    q, t = quaternion.from_rotation_vector(np.array([0.6, -1.2, 0.9])), np.array([1.0, 2, 3])
    grabbed = np.array([0, 3, 16])
    placed, turns = grab(XYZ, EDGES, grabbed, pose.transform(q, t, XYZ[grabbed]))
    np.testing.assert_allclose(placed, pose.transform(q, t, XYZ), atol=1e-6)
    np.testing.assert_allclose(np.abs(turns @ q), 1, atol=1e-6)
    assert stiffness(XYZ, EDGES, placed) < 1e-9


def test_one_node_alone_takes_everything_along():
    placed, turns = grab(XYZ, EDGES, np.array([7]), XYZ[[7]] + [0, 0, 1])
    np.testing.assert_allclose(placed, XYZ + np.array([0, 0, 1]), atol=1e-3)
    np.testing.assert_allclose(turns, np.tile(quaternion.IDENTITY, (len(XYZ), 1)), atol=1e-3)


def test_as_rigid_as_a_general_minimiser_makes_it():
    """The energy is that of the best positions by L-BFGS on the same energy, within one percent."""
    grabbed, free = np.array([17]), np.arange(4, 20)
    target = XYZ[grabbed] + [0.5, 0, 1.5]
    placed, _ = grab(XYZ, EDGES, grabbed, target, free)
    moves = np.setdiff1d(free, grabbed)

    def energy(x):
        trial = placed.copy()
        trial[moves] = x.reshape(-1, 3)
        return stiffness(XYZ, EDGES, trial)

    best = minimize(energy, placed[moves].ravel(), method="L-BFGS-B", options={"maxiter": 60}).fun
    stiff = XYZ.copy()
    stiff[grabbed] = target
    print(
        f"energy {energy(placed[moves].ravel()):.4f}, minimiser {best:.4f}, node alone {stiffness(XYZ, EDGES, stiff):.4f}"
    )
    assert energy(placed[moves].ravel()) < 1.01 * best + 1e-9
    assert stiffness(XYZ, EDGES, placed) < 0.5 * stiffness(XYZ, EDGES, stiff)
    np.testing.assert_array_equal(placed[grabbed], target)
    np.testing.assert_array_equal(placed[:4], XYZ[:4])


def test_nothing_moves_without_a_pull():
    placed, turns = grab(XYZ, EDGES, np.array([3]), XYZ[[3]], np.arange(10))
    np.testing.assert_array_equal(placed, XYZ)
    np.testing.assert_array_equal(turns, np.tile(quaternion.IDENTITY, (len(XYZ), 1)))


@pytest.mark.parametrize("line", [np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])])
def test_a_line_of_nodes_and_a_lone_one(line):
    """Turns about a line are open and stay small; a node without edges and repeated places do no harm."""
    xyz = np.concatenate([line, [[9.0, 9, 9]], line[:1]])
    placed, turns = grab(xyz, np.array([[0, 1], [1, 2], [2, 3], [0, 5]]), np.array([3]), np.array([[0.0, 3, 0]]))
    assert np.isfinite(placed).all() and np.isfinite(turns).all()
    np.testing.assert_allclose(placed[4], xyz[4], atol=1e-6)
    assert np.abs(turns[:, 1]).max() < 1e-3


def test_within_reach_goes_along_edges():
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0.1, 0]])  # 3 is near 0, but far along the edges
    edges = np.array([[0, 1], [1, 2], [2, 3]])
    assert within_reach(xyz, edges, np.array([0]), 2.0).tolist() == [0, 1, 2]
    assert within_reach(xyz, edges, np.array([0]), 0.0).tolist() == [0]
    assert within_reach(xyz, edges, np.array([2]), 1.9).tolist() == [1, 2, 3]  # and against their order


def test_an_offset_is_held_in_the_nodes_own_frame():
    """A node on a wheel that is lifted off it stays lifted off all the way round, and half as much at half share."""
    angles = np.linspace(0, np.pi, 5)
    quat = quaternion.from_rotation_vector(angles[:, None, None] * [[0.0, 0, 1]])
    xyz = quaternion.rotate(quat, np.array([1.0, 0, 0]))
    offset = np.array([quaternion.IDENTITY]), np.array([[0.5, 0, 0]])
    placed, turned = add_offset(xyz, quat, offset, np.array([1, 1, 0.5, 0, 1.0]))
    np.testing.assert_allclose(np.linalg.norm(placed[:, 0], axis=-1), [1.5, 1.5, 1.25, 1, 1.5])
    np.testing.assert_allclose(turned, quat, atol=1e-12)


def test_an_offset_turns_a_node_by_its_fraction_too():
    quat = quaternion.from_rotation_vector(np.array([[[0.0, 0, 0.5]], [[0, 0.3, 0]]]))
    xyz = np.array([[[1.0, 2, 3]], [[4, 5, 6]]])
    offset = quaternion.from_rotation_vector(np.array([[0.8, 0, 0]])), np.array([[0.2, -0.4, 0.6]])
    placed, turned = add_offset(xyz, quat, offset, np.array([0.25, 0.5]))
    for frame, fraction in enumerate((0.25, 0.5)):
        turn = quaternion.from_rotation_vector(np.array([0.8 * fraction, 0, 0]))
        np.testing.assert_allclose(turned[frame, 0], quaternion.multiply(quat[frame, 0], turn), atol=1e-12)
        moved = xyz[frame, 0] + quaternion.rotate(quat[frame, 0], fraction * offset[1][0])
        np.testing.assert_allclose(placed[frame, 0], moved, atol=1e-12)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_what_a_pull_does_is_the_same_in_every_unit(unit):
    grabbed, free = np.array([17]), np.arange(4, 20)
    target = XYZ[grabbed] + [0.5, 0, 1.5]
    placed, turns = grab(XYZ, EDGES, grabbed, target, free)
    scaled, same = grab(unit * XYZ, EDGES, grabbed, unit * target, free)
    np.testing.assert_allclose(scaled / unit, placed, atol=1e-6)
    np.testing.assert_allclose(same, turns, atol=1e-6)


def test_nodes_that_are_all_grabbed_are_where_they_are_put_and_turn_with_their_edges():
    q = quaternion.from_rotation_vector(np.array([0.3, 0.7, -0.2]))
    targets = quaternion.rotate(q, XYZ)
    placed, turns = grab(XYZ, EDGES, np.arange(len(XYZ)), targets)
    np.testing.assert_array_equal(placed, targets)
    np.testing.assert_allclose(np.abs(turns @ q), 1, atol=1e-9)


def hinge(frames=12) -> tuple[np.ndarray, np.ndarray]:
    """Two boards joined at the origin, one of which swings while both travel; the board (M,) of each node."""
    random = np.random.default_rng(1)
    first, second = random.uniform(-1, 0, (30, 3)), random.uniform(0, 1, (18, 3))
    swing = quaternion.from_rotation_vector(np.linspace(0, 1.2, frames)[:, None, None] * [[0.0, 0, 1]])
    travel = np.linspace(0, 2, frames)[:, None, None] * [1.0, 0, 0]
    xyz = np.concatenate([np.tile(first, (frames, 1, 1)), quaternion.rotate(swing, second)], 1) + travel
    return xyz, np.repeat([0, 1], [30, 18])


def test_boards_of_a_hinge_are_two_groups():
    xyz, board = hinge()
    group = rigid_groups(xyz, 2)
    assert (group == board).mean() > 0.95
    assert (np.diff(np.bincount(rigid_groups(xyz))) <= 0).all()
    assert rigid_groups(xyz).max() == 1


def wagons(noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Four wagons of 40 nodes each, one long, that go straight and then round a bend of radius 3; which wagon each node is of."""
    random = np.random.default_rng(0)
    wagon, frames = np.repeat(np.arange(4), 40), np.arange(30)
    local = random.uniform([-0.45, -0.15, -0.15], [0.45, 0.15, 0.15], (160, 3))
    way = 0.2 * frames[:, None] - wagon
    angle = np.maximum(way, 0) / 3
    zero = np.zeros_like(angle)
    turn = quaternion.from_rotation_vector(np.stack([zero, -angle, zero], -1))
    place = np.stack([np.where(way < 0, way, 3 * np.sin(angle)), zero, 3 * (1 - np.cos(angle))], -1)
    phase, speed = random.uniform(0, 6, (160, 3)), random.uniform(0.1, 0.4, (160, 3))
    return quaternion.rotate(turn, local) + place + noise * np.sin(phase + speed * frames[:, None, None]), wagon


@pytest.mark.parametrize(("noise", "right"), [(0.0, 1.0), (0.002, 1.0), (0.02, 0.85)])
def test_four_wagons_are_four_groups(noise, right):
    xyz, wagon = wagons(noise)
    group = rigid_groups(xyz)
    assert group.max() == 3
    assert np.mean([np.bincount(group[wagon == number]).max() / 40 for number in range(4)]) >= right


def test_one_noisy_thing_is_one_group():
    xyz, wagon = wagons(0.05)
    assert rigid_groups(xyz[:, wagon == 0]).max() == 0


def test_rigidity_of_one_thing_is_its_nearness_alone():
    xyz, board = hinge()
    distance = nonrigidity(xyz)
    same = board[:, None] == board
    mean = np.linalg.norm(xyz[:, :, None] - xyz[:, None], axis=-1).mean(0)
    np.testing.assert_allclose(distance[same], 0.05 * mean[same], atol=1e-12)
    assert np.median(distance[~same]) > 5 * np.median(distance[same])


def test_the_motion_of_a_group():
    xyz, board = hinge()
    quat, place = group_motion(xyz[:, board == 1])
    local = pose.transform(*pose.invert(quat[:, None], place[:, None]), xyz[:, board == 1])
    np.testing.assert_allclose(local, np.tile(local[0], (len(xyz), 1, 1)), atol=1e-9)
    assert np.abs(quaternion.to_rotation_vector(quat[-1]) - [0, 0, 1.2]).max() < 1e-9
    assert (group_motion(xyz[:, :2])[0] == quaternion.IDENTITY).all()
    assert rigid_groups(xyz[:, :1]).tolist() == [0]
