"""What carries the Gaussians of a node that is missing."""

import numpy as np

from f4x_core.scaffold.missing import carriers


def test_a_missing_pair_is_carried_by_the_nearest_with_its_reference():
    reference = np.array([0, 0, 0, 1, 1, 2])
    place = np.array([[0, 0, 0], [1, 0, 0], [5, 0, 0], [0.1, 0, 0], [4, 0, 0], [0, 0, 0]], float)
    there = np.array([False, True, True, False, True, False])
    np.testing.assert_array_equal(carriers(reference, place, there), [1, 1, 2, 4, 4, 4])


def test_without_any_node_each_pair_stays_its_own():
    np.testing.assert_array_equal(carriers(np.zeros(3, int), np.zeros((3, 3)), np.zeros(3, bool)), [0, 1, 2])
    np.testing.assert_array_equal(carriers(np.zeros(2, int), np.zeros((2, 3)), np.ones(2, bool)), [0, 1])
