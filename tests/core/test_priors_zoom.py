"""A lens that zooms: the figures that it is decided by, and that the sizes of pictures and aligned tracks depend on."""

from dataclasses import replace

import numpy as np
import pytest
from test_priors_cameras import FOCAL, WIDTH, observe, truth, zoom_of

from f4x_core.priors import zoom as module
from f4x_core.priors.bundle import BundleConfig, adjust
from f4x_core.priors.sfm import Solution, refocused
from f4x_core.priors.zoom import Zoom


def turning(frames=9, factor=1.3, noise=0.2, points=80):
    """A camera that turns and zooms, as one that only turns would explain it: points on a sphere."""
    true = replace(truth(frames=frames, travel=0.0, turn=0.3, points=points), zoom=zoom_of(frames, factor))
    seen = observe(true, noise)
    points = true.points / np.linalg.norm(true.points, axis=1, keepdims=True)
    return true, Solution(replace(true, zoom=None, points=points), seen, np.ones(frames, bool))


def test_the_mean_cost_is_per_degree_of_freedom():
    _, solution = turning()
    seen = solution.observations
    errors = np.minimum(solution.bundle.errors(seen), 1e3)
    mean = np.mean(np.log(1 + errors**2))
    assert module.mean_cost(solution.bundle, seen) == pytest.approx(mean)
    count = 2 * len(seen.frame)
    assert module.mean_cost(solution.bundle, seen, count // 3) == pytest.approx(mean / (1 - (count // 3) / count))
    assert module.mean_cost(solution.bundle, seen, count) == pytest.approx(mean / 0.1)
    behind = replace(solution.bundle, points=-solution.bundle.points)
    assert module.mean_cost(behind, seen) == pytest.approx(np.log(1 + 1e6))


def test_a_zoom_is_compared_with_turning_alone():
    true, solution = turning()
    frames, lens = np.arange(9) * 3, BundleConfig(refine_focal=False)
    found = module.find_zoom(solution, frames, lens)
    held = replace(lens, refine_centers=False)
    still = module.adjust_coarse_to_fine(solution.bundle, solution.observations, held)
    zooming = module.adjust_coarse_to_fine(still, solution.observations, replace(held, refine_zoom=True))
    costs = [
        module.mean_cost(one, solution.observations, unknowns * 9 + 2 * 80)
        for one, unknowns in ((still, 3), (zooming, 4))
    ]
    assert found.left == pytest.approx(costs[1] / costs[0], rel=1e-9) and found.cost == pytest.approx(
        costs[1], rel=1e-9
    )
    assert found.factor == pytest.approx(zooming.focals.max() / zooming.focals.min())
    assert found.factor == pytest.approx(1.3, rel=0.03) and found.explains
    np.testing.assert_allclose(found.logarithm, np.log(zooming.focals))
    assert found.frames is frames
    for factor, left, explains in ((1.05, 0.4, True), (1.049, 0.4, False), (1.05, 0.401, False)):
        assert Zoom(factor, left, 1.0, found.logarithm, frames).explains == explains
    summary = found.summary(replace(true, zoom=true.zoom), WIDTH)
    focals = true.focals
    assert summary["factor"] == pytest.approx(1.3, abs=6e-4)
    assert summary["first"] == pytest.approx(focals[0] / WIDTH, abs=6e-4)
    assert summary["last"] == pytest.approx(focals[-1] / WIDTH, abs=6e-4)
    assert summary["left"] == pytest.approx(found.left, abs=6e-4)


@pytest.mark.parametrize("known", [None, 1.2 * FOCAL])
def test_all_frames_take_the_zoom_of_the_sampled_ones(known):
    true, solution = turning(frames=12)
    sampled = np.array([0, 4, 11])
    zoom = Zoom(1.3, 0.1, 0.1, np.log(1.1 * true.focals[sampled]), sampled)
    found = module.zoomed(solution, zoom, known).bundle
    logarithm = np.interp(np.arange(12), sampled, zoom.logarithm)
    usual = np.exp(logarithm.mean())
    start = refocused(solution, usual, translating=False).bundle
    start = replace(start, zoom=np.exp(logarithm) / usual)
    config = BundleConfig(refine_focal=False, refine_zoom=True, refine_centers=False)
    expected = module.adjust_coarse_to_fine(start, solution.observations, config)
    if known is not None:
        other = refocused(replace(solution, bundle=expected), expected.focal * known / expected.focals[0], False)
        expected = adjust(other.bundle, solution.observations, replace(config, refine_zoom=False))
        assert found.focals[0] == pytest.approx(known)
    np.testing.assert_allclose(found.focals, expected.focals, rtol=1e-9)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-9)
    assert not found.center.any()
