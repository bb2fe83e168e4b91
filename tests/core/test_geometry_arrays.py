import numpy as np
import pytest
from scipy.stats import spearmanr

from f4x_core.geometry.arrays import evenly_spaced, rank_correlation


@pytest.mark.parametrize(
    ("length", "count", "expected"),
    [
        (10, 4, [0, 3, 6, 9]),
        (10, 3, [0, 4, 9]),  # 4.5 is rounded to the even neighbour
        (5, 5, [0, 1, 2, 3, 4]),
        (3, 8, [0, 1, 2]),
        (7, 1, [0]),
        (1, 4, [0]),
        (0, 4, []),
        (4, 0, []),
    ],
)
def test_indices_are_spread_evenly_and_the_ends_are_among_them(length, count, expected):
    indices = evenly_spaced(length, count)
    assert indices.dtype == np.int64 and indices.tolist() == expected


def test_more_indices_than_there_are_give_each_one_once():
    for length in range(1, 60):
        for count in range(1, 90):
            spelled_out = np.unique(np.linspace(0, length - 1, count).round().astype(int))
            assert np.array_equal(evenly_spaced(length, count), spelled_out)


def test_without_ends_short_lengths_keep_what_there_is():
    wanted = {(9, 3): [2, 4, 6], (3, 3): [0, 1, 2], (1, 2): [0], (0, 2): []}
    for arguments, indices in wanted.items():
        assert evenly_spaced(*arguments, ends=False).tolist() == indices


@pytest.mark.parametrize("levels", [3, 1000])
def test_rank_correlation_is_spearmans_with_equal_values_too(levels):
    rng = np.random.default_rng(levels)
    a = rng.integers(0, levels, 200) / 7
    b = np.exp(a) + rng.integers(0, 4 * levels, 200)
    assert rank_correlation(a, b) == pytest.approx(spearmanr(a, b)[0], abs=1e-12)
    assert rank_correlation(a, -(a**3)) == pytest.approx(-1)
    assert np.isnan(rank_correlation(np.where(a > a.min(), a, np.nan), b)) and np.isnan(rank_correlation(a, 0 * b))
