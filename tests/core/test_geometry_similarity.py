"""Points that were moved as one are found again as the similarity that moved them."""

import numpy as np
import pytest

from f4x_core.geometry import quaternion
from f4x_core.geometry.similarity import fit_similarity, split_by_motion


def cloud(count=200, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)


@pytest.mark.parametrize(("turn", "scale"), [((0, 0, 0), 1.0), ((0.3, -1.1, 2.0), 1.0), ((0, 0.5, 0), 2.5)])
def test_one_similarity_is_found_to_rounding(turn, scale):
    before, rotation = cloud(), quaternion.from_rotation_vector(np.array(turn, float))
    pivot = before.astype(np.float64).mean(0)
    after = (pivot + scale * quaternion.rotate(rotation, before - pivot) + [0.5, 0, -2]).astype(np.float32)
    found = fit_similarity(before, after)
    assert found is not None and found.scale == pytest.approx(scale, abs=1e-5)
    np.testing.assert_allclose(found.translation, [0.5, 0, -2], atol=1e-5)
    np.testing.assert_allclose(np.abs(found.rotation), np.abs(rotation), atol=1e-5)


def test_groups_that_went_different_ways_and_points_that_went_their_own():
    before = cloud()
    after = before.copy()
    after[:120] += np.float32([1, 0, 0])
    after[120:180] += np.float32([0, 0, 0.25])
    after[180:] += cloud(20, 1)
    groups, rest = split_by_motion(before, after, 2)
    assert [len(rows) for rows, _ in groups] == [120, 60] and rest.tolist() == list(range(180, 200))
    assert split_by_motion(before[:0], before[:0], 2)[0] == []
    assert fit_similarity(before, cloud(200, 1)) is None
