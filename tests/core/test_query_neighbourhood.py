"""Growing, shrinking and pointing, against distances worked out one by one."""

import numpy as np
import pytest
from labelled_scene import SQUARE, WALL, labelled_scene

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
