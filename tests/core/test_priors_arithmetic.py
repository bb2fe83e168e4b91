"""Arithmetic of the priors that only a worse scene would show to be wrong, beside its own words."""

import numpy as np
import pytest

from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.quaternion import angles_between
from f4x_core.priors.bundle import _Problem
from f4x_core.priors.contact import growth
from f4x_core.priors.depth import _confidence, below_horizon, ground_prior
from f4x_core.priors.flow import pixel_grid
from f4x_core.priors.folder import Priors
from f4x_core.priors.motion import THRESHOLD_LIFT, find_threshold


def test_ground_is_below_the_horizon_through_any_lens():
    """Inverse depth is 0.7 plus the sine below the horizon, times the ray's length, pixel by pixel."""
    lens = np.array([[[20.0, 0, 5], [0, 30.0, 2], [0, 0, 1]]])
    cameras = CameraPath(lens, np.eye(4)[None], np.zeros(1), 12, 8)
    x, y = (np.arange(12) + 0.5 - 5)[None, :] / 20, (np.arange(8) + 0.5 - 2)[:, None] / 30
    length = np.sqrt(x**2 + y**2 + 1)
    below = np.maximum(y, 0) * np.ones_like(x)
    np.testing.assert_allclose(
        below_horizon(cameras[0], pixel_grid(8, 12), np.array([0.0, 1, 0])), np.stack([below, length], -1), rtol=1e-5
    )
    np.testing.assert_allclose(ground_prior(cameras)[0], 0.7 * length + below, rtol=1e-5)


def test_angles_between_rotations():
    turns = np.array([0.1, 1.0, 3.0])
    turned = quaternion.to_matrix(quaternion.from_rotation_vector(np.outer(turns, [0.6, 0, 0.8])))
    np.testing.assert_allclose(angles_between(turned, np.tile(np.eye(3), (3, 1, 1))), turns, rtol=1e-9)


def test_otsus_threshold_parts_two_heaps():
    """Every bin between the heaps parts them equally well; the first of them, where the lower heap ends, is taken."""
    score = np.concatenate([np.full(500, 0.4), np.full(500, 0.8)])
    assert find_threshold(score) == pytest.approx(0.4 + THRESHOLD_LIFT, abs=1 / 256)


def test_growth_of_a_region_is_that_of_most_of_its_pixels():
    """A twentieth of the flow is 30 pixels wrong; weights of plain least squares would take it in."""
    y, x = np.mgrid[:40, :40] + 0.5
    flow = 0.1 * np.stack([x - 20, y - 20], -1)
    flow[36:, 20:] += 30
    priors = Priors(40, 40, np.arange(2), flow_forward=flow[None], flow_forward_mask=np.ones((1, 40, 40), bool))
    assert growth(priors, 0, np.ones((40, 40), bool)) == pytest.approx(np.log(1.1), abs=0.01)


def test_depth_that_samples_contradict_is_trusted_less():
    filled, precision = np.full((24, 24), 0.5), np.full((24, 24), 1600.0)
    agreed, contradicted = (_confidence(filled, filled * factor, precision) for factor in (1.0, 1.1))
    np.testing.assert_allclose(agreed, 400 / 450, rtol=1e-6)
    np.testing.assert_allclose(contradicted, 400 / 450 / (1 + 0.5**2), rtol=1e-6)


def test_centring_a_problem_remembers_its_unit():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.normal(size=(50, 3)) + np.array([0, 0, 8]), np.ones(50)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rotation, center = np.tile(np.eye(3), (3, 1, 1)), rng.normal(size=(3, 3))
    before = _Problem(100.0, np.ones(3), np.zeros(2), rotation, center, points, np.zeros(3), 1.0)
    after = before.centred()
    for problem in (after, after.centred()):
        world = problem.origin + problem.unit * problem.points[:, :3] / problem.points[:, 3:]
        np.testing.assert_allclose(world, points[:, :3] / points[:, 3:], rtol=1e-6)
        np.testing.assert_allclose(problem.origin + problem.unit * problem.center, center, atol=1e-9)
