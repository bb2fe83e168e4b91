"""Order by depth: the compiled radix sort against numpy's stable sort."""

import numpy as np
import pytest

from f4x_core.errors import F4xError
from f4x_core.scene import depth_order as module
from f4x_core.scene.depth_order import OrderSettings, depth_order


def random_problem(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Two clouds, many equal depths, some Gaussians behind the camera, far away, transparent or not finite."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3)).astype(np.float32)
    means[:, 2] = np.round(means[:, 2] * 40) / 40 + 1.5
    opacities = rng.uniform(0, 1, count).astype(np.float32)
    opacities[::7] = 0
    means[3::101] = np.nan
    rows = np.array([[0, 0, 1, 0], [0, 0, 1, 0.25]], np.float32)
    return {"means": means, "opacities": opacities, "starts": np.array([0, count // 3, count]), "rows": rows}


def ordered(problem: dict[str, np.ndarray], **settings) -> np.ndarray:
    out = np.full(len(problem["means"]), -1, np.float32)
    found = depth_order(
        **problem, settings=OrderSettings(**{"near": 0.2, "far": 3.0, "alpha_min": 1 / 255} | settings), out=out
    )
    return out[:found].astype(int)


def depths(problem: dict[str, np.ndarray]) -> np.ndarray:
    cloud = np.repeat(np.arange(2), np.diff(problem["starts"]))
    return problem["means"][:, 2] + problem["rows"][cloud, 3]


@pytest.mark.parametrize("count", [0, 1, 2, 999, 200_000])
@pytest.mark.parametrize("threads", [1, 3])
def test_farthest_first_and_of_equal_depths_the_larger_index(count, threads):
    problem = random_problem(count)
    z = depths(problem)
    seen = np.flatnonzero((z > 0.2) & (z < 3) & (problem["opacities"] >= 1 / 255))
    expected = seen[np.lexsort((seen, z[seen]))][::-1]
    assert np.array_equal(ordered(problem, threads=threads), expected)


def test_without_the_library_numpy_gives_the_same(monkeypatch):
    problem = random_problem(5000)
    expected = ordered(problem)
    monkeypatch.setattr(module, "open_library", lambda: (None, "not there"))
    assert len(expected) and np.array_equal(ordered(problem), expected)


def test_the_coarse_order_has_the_same_gaussians_at_nearly_the_same_depths():
    problem = random_problem(100_000)
    exact, coarse = ordered(problem), ordered(problem, coarse=True, threads=2)
    z = depths(problem)
    assert np.array_equal(np.sort(exact), np.sort(coarse))
    assert np.max(np.abs(z[exact] - z[coarse]) / z[exact]) < 2e-3
    assert np.array_equal(coarse, ordered(problem, coarse=True))


def test_too_many_gaussians_are_refused_in_a_sentence(monkeypatch):
    monkeypatch.setattr(module, "EXACT_COUNT", 10)
    with pytest.raises(F4xError, match="11 Gaussians are too many, 10 can be drawn"):
        ordered(random_problem(11))
