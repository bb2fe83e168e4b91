"""A random walker with priors, against its normal equations; and probabilities of log-odds."""

import numpy as np
import pytest

from f4x_core.query.random_walk import walk_with_prior
from f4x_core.query.score import logistic


def walk_by_matrices(bonds, prior, fixed, trust):
    """(h,w) and the sum of squared residuals of any x: the normal equations of `walk_with_prior`."""
    height, width = prior.shape
    cells = np.arange(height * width).reshape(height, width)
    between = np.zeros((height * width,) * 2)
    between[cells[1:], cells[:-1]] = between[cells[:-1], cells[1:]] = bonds[0]
    between[cells[:, 1:], cells[:, :-1]] = between[cells[:, :-1], cells[:, 1:]] = bonds[1]
    matrix = trust * np.eye(height * width) + np.diag(between.sum(1)) - between
    right, x, free = trust * prior.ravel(), fixed.ravel().astype(float), np.isnan(fixed.ravel())
    x[free] = np.linalg.solve(matrix[free][:, free], right[free] - matrix[free][:, ~free] @ x[~free])
    return x.reshape(height, width), lambda x: (((matrix @ x.ravel().astype(float) - right)[free]) ** 2).sum()


def bonds_of(height, width, seed):
    random = np.random.default_rng(seed)
    return random.random((height - 1, width)), random.random((height, width - 1))


@pytest.mark.parametrize(("seed", "prior"), [(0, 0.1), (1, 1e-3), (2, 1e-3), (3, 3.0)])
def test_a_random_walk_is_the_solution_of_its_normal_equations(seed, prior):
    """Also with a weak prior, where conjugate gradients alone arrive."""
    random = np.random.default_rng(seed)
    bonds, wanted, fixed = bonds_of(12, 10, seed), random.random((12, 10)), np.full((12, 10), np.nan)
    fixed[0, :4], fixed[11, 9], fixed[5, 5] = 1.0, 0.0, 0.25
    expected, residual = walk_by_matrices(bonds, wanted, fixed, prior)
    found = walk_with_prior(bonds, wanted, fixed, prior)
    np.testing.assert_allclose(found, expected, atol=1e-5 / prior)
    assert residual(found) < 1e-9 and found.dtype == np.float32


def test_a_random_walk_without_fixed_cells_stays_in_the_unit_range():
    wanted, free = np.linspace(0, 1, 20).reshape(4, 5) ** 3, np.full((4, 5), np.nan)
    found = walk_with_prior(bonds_of(4, 5, 3), wanted, free, 0.1)
    np.testing.assert_allclose(found, walk_by_matrices(bonds_of(4, 5, 3), wanted, free, 0.1)[0], atol=1e-4)


def test_log_odds_and_probabilities():
    odds = np.array([-29.0, -1.5, 0.0, 0.3, 12.0])
    found = logistic(odds)
    np.testing.assert_allclose(np.log(found) - np.log1p(-found), odds, atol=1e-6)
    ends = logistic(np.array([-1e6, 1e6]))
    assert ends[0] == pytest.approx(np.exp(-30), rel=1e-9, abs=0) and 1 - ends[1] == pytest.approx(
        np.exp(-30), rel=0.01, abs=0
    )
