"""Arithmetic of queries that a picture or a score would hardly show to be wrong, beside its own words."""

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.query.pixels import HEAT, coverage_image, heat_map
from f4x_core.query.score import average_precision
from f4x_core.query.selection import Selection
from f4x_core.scene.visualise import SPECTRUM


def test_a_heat_map_is_colour_over_the_grey_of_the_picture():
    picture = np.array([[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]])
    grey = np.array([0.299, 0.587, 0.114])[:, None]
    middle = 2 / (len(SPECTRUM) - 1)
    for score, colour in ((0.0, SPECTRUM[0]), (middle, SPECTRUM[2]), (1.0, SPECTRUM[-1])):
        expected = 255 * (HEAT * colour + (1 - HEAT) * grey)
        assert np.abs(heat_map(picture, np.full((1, 3), score))[0] - expected).max() <= 0.5 + 1e-9


def test_soft_coverage_counts_scores():
    scene = labelled_scene()
    count = len(scene.ids)
    half = Selection(scene.ids, np.full(count, 0.5), np.zeros(count, bool), 0.4, None, "half")
    hard, soft = (coverage_image(scene, half, scene.cameras[0], 0.0, soft=soft) for soft in (False, True))
    assert hard.max() > 0.5
    np.testing.assert_allclose(soft, 0.5 * hard, atol=1e-5)


def test_precision_of_a_late_hit():
    assert average_precision(np.array([0.9, 0.8, 0.7]), np.array([False, False, True])) == pytest.approx(1 / 3)
    assert average_precision(np.array([0.5]), np.array([True])) == 1
