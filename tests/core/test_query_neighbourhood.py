"""Growing, shrinking and pointing, against distances worked out one by one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import SQUARE, WALL, labelled_scene
from scipy.spatial.transform import Rotation

from f4x_core.query import neighbourhood
from f4x_core.query.neighbourhood import FINE, grow_selection, meeting, shrink_selection

REACH = 0.1


@pytest.fixture(scope="module")
def cloud():
    random = np.random.default_rng(3)
    points = random.uniform(-1, 1, (3000, 3)).astype(np.float32)
    return points, np.linalg.norm(points, axis=1) < 0.5


def test_growing_finds_what_is_within_reach_to_a_cell(cloud):
    points, chosen = cloud
    nearest = np.linalg.norm(points[:, None] - points[chosen], axis=-1).min(1)
    found, cell = grow_selection(points, chosen, REACH), np.sqrt(3) * REACH / FINE
    assert found[chosen].all()
    assert found[nearest < REACH - cell].all() and not found[nearest > REACH + cell].any()
    assert chosen.sum() < found.sum() < len(points)


def test_shrinking_is_growing_of_the_rest(cloud):
    points, chosen = cloud
    np.testing.assert_array_equal(shrink_selection(points, chosen, REACH), ~grow_selection(points, ~chosen, REACH))
    assert 0 < shrink_selection(points, chosen, REACH).sum() < chosen.sum()


@pytest.mark.parametrize("chosen", [False, True])
def test_nothing_grows_to_nothing_and_all_stays_all(cloud, chosen):
    points, _ = cloud
    every = np.full(len(points), chosen)
    np.testing.assert_array_equal(grow_selection(points, every, REACH), every)


def test_a_floater_far_away_costs_no_memory(cloud):
    points, chosen = cloud
    far = np.concatenate([points, [[1e6, 0, 0]]]).astype(np.float32)
    assert not grow_selection(far, np.append(chosen, False), REACH)[-1]


def test_a_ray_meets_the_nearer_surface():
    scene = labelled_scene()
    posed, camera = scene.posed(3.0), scene.cameras.at(3.0)
    pixel, _ = camera.project(posed.means[posed.dynamic].mean(0)[None])
    for at, depth in ((pixel[0], SQUARE), (np.array([60.0, 4.0]), WALL)):
        there = meeting(posed, camera.center, camera.unproject(at, np.array(1.0)) - camera.center)
        assert camera.project(there[None])[1][0] == pytest.approx(depth, abs=0.02)
    assert meeting(posed, camera.center, np.array([0.0, 0.0, -1.0])) is None


def grown_by_loops(points, chosen, width):
    """Which cells of that width lie within two steps of a cell of a chosen point."""
    cells = np.floor(points / width).astype(int)
    steps = ((cells[:, None] - cells[chosen]) ** 2).sum(-1)
    return chosen | (steps <= neighbourhood.FINE**2).any(1)


@pytest.mark.parametrize("fine", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_growing_counts_cells(monkeypatch, seed, fine):
    """Few points and long boxes: rows of cells begin where others end."""
    monkeypatch.setattr(neighbourhood, "FINE", fine)
    random = np.random.default_rng(seed)
    points = random.uniform(-0.3, 0.3, (150, 3)) * random.permutation([1, 0.5, 0.7]) + random.normal(size=3)
    chosen = random.random(150) < 0.06
    for reach in (0.05, 0.1, 0.3):
        found = grow_selection(points, chosen, reach)
        np.testing.assert_array_equal(found, grown_by_loops(points, chosen, reach / fine))
        assert not grow_selection(points, ~chosen & chosen, reach).any()
    assert grow_selection(points[:1], chosen[:1] | True, 0.1).all()


def test_cells_are_no_finer_than_their_number_allows(monkeypatch):
    monkeypatch.setattr(neighbourhood, "MAX_CELLS", 8)
    random = np.random.default_rng(5)
    points, chosen = random.uniform(0, [1, 2, 3], (100, 3)), random.random(100) < 0.05
    width = np.ptp(points[:, 2]) / 8
    np.testing.assert_array_equal(grow_selection(points, chosen, 0.01), grown_by_loops(points, chosen, width))
    np.testing.assert_array_equal(shrink_selection(points, ~chosen, 0.01), ~grown_by_loops(points, chosen, width))
    same = np.zeros((3, 3))
    with np.errstate(all="raise"):
        np.testing.assert_array_equal(grow_selection(same, np.arange(3) == 1, 0.0), np.ones(3, bool))


def meeting_by_loops(posed, origin, direction):
    """Light that is left behind each Gaussian in turn, by its covariance."""
    met = []
    for mean, quat, scale, opacity in zip(posed.means, posed.quats, posed.scales, posed.opacities, strict=True):
        turn = Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()
        precision = turn @ np.diag(scale**-2.0) @ turn.T
        distance = direction @ precision @ (mean - origin) / (direction @ precision @ direction)
        off = mean - origin - distance * direction
        alpha = opacity * np.exp(-0.5 * off @ precision @ off)
        if distance > 0 and alpha > 1 / 255:
            met.append((distance, alpha))
    left = 1.0
    for distance, alpha in sorted(met):
        left *= 1 - alpha
        if left <= 0.5:
            return origin + distance * direction
    return None


def test_a_ray_meets_what_takes_half_of_its_light():
    random, some = np.random.default_rng(6), []
    for _ in range(40):
        count = 12
        quats = random.normal(size=(count, 4))
        posed = SimpleNamespace(
            means=random.normal((0, 0, 1.5), size=(count, 3)),
            quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
            scales=np.exp(random.normal(-0.5, 0.7, (count, 3))),
            opacities=0.4 * random.random(count),
        )
        origin, direction = 0.2 * random.normal(size=3), np.array([0.1, -0.2, 1.0]) * random.uniform(0.3, 3)
        found, expected = meeting(posed, origin, direction), meeting_by_loops(posed, origin, direction)
        assert (found is None) == (expected is None)
        if expected is not None:
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
        some.append(expected is not None)
    assert 0.3 < np.mean(some) < 0.95


def on_the_axis(*gaussians):
    """Round Gaussians (distance, opacity) on the z axis, met by a ray of length 2."""
    count = len(gaussians)
    means = np.array([[0, 0, distance] for distance, _ in gaussians])
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    posed = SimpleNamespace(
        means=means, quats=quats, scales=np.full((count, 3), 0.01), opacities=np.array([o for _, o in gaussians])
    )
    return meeting(posed, np.zeros(3), np.array([0, 0, 2.0]))


def test_what_a_ray_just_meets():
    """Half of the light is enough; what is at the origin or behind is not met, nor what hardly shows."""
    assert on_the_axis((3.0, 0.5)).tolist() == [0, 0, 3]
    assert on_the_axis((3.0, 0.499)) is None
    assert on_the_axis((0.0, 0.9)) is None and on_the_axis((-1.0, 0.9)) is None and on_the_axis((0.3, 0.9))[2] == 0.3
    assert on_the_axis((1.0, 0.003915), (2.0, 0.4985)) is None  # fainter than 1/255
    assert on_the_axis((1.0, 0.00393), (2.0, 0.4985))[2] == 2
    assert on_the_axis((4.0, 0.4), (2.0, 0.4))[2] == 4 and on_the_axis((4.0, 0.9), (2.0, 0.6))[2] == 2


def test_a_flat_gaussian_is_met_too():
    posed = SimpleNamespace(
        means=np.array([[0, 0, 2.0]]), quats=np.eye(1, 4), scales=np.array([[0.1, 0.1, 0.0]]), opacities=np.array([0.9])
    )
    found = meeting(posed, np.zeros(3), np.array([0.01, 0.0, 1.0]))
    np.testing.assert_allclose(found, [0.02, 0, 2], atol=1e-6)


def test_a_ray_in_float32_meets_what_one_in_float64_does():
    """As of Blender 5.2 matrices and vectors come in float32, in which thin Gaussians seen from afar were missed or met beside."""
    posed = labelled_scene().posed(3.0)
    posed = replace(
        posed, scales=np.minimum(posed.scales, np.float32([1, 1, 1e-6])), opacities=0 * posed.opacities + 0.9
    )
    origin, target = np.array([3.0, 2.0, -30.0]), np.array([0.3, 0.2, WALL])
    exact = meeting(posed, origin, target - origin)
    assert exact is not None
    np.testing.assert_allclose(exact[2], WALL, atol=1e-3)
    found = meeting(posed, origin.astype(np.float32), (target - origin).astype(np.float32))
    np.testing.assert_allclose(found, exact, atol=1e-3)
    beside = (np.array([4.0, 3.0, WALL]) - origin).astype(np.float32)  # past everything
    assert meeting(posed, origin.astype(np.float32), beside) is None
