"""Whether a picture is of a scene."""

import numpy as np
from labelled_scene import labelled_scene

from f4x_core.scene.resemblance import ALIKE, resemblance
from f4x_core.scene.view import render


def test_a_picture_of_the_scene_is_like_it_at_any_size_and_another_is_not():
    scene = labelled_scene()
    own = render(scene, scene.cameras.at(2.0).resized(300, 188), 2.0, ("rgb",))["rgb"].mean(-1)
    assert resemblance(scene, 2.0, own) > 0.95
    assert resemblance(scene, 2.0, 0.3 * own[::4, ::4] + 0.1) > ALIKE  # darker, flatter, smaller
    assert abs(resemblance(scene, 2.0, np.random.default_rng(0).random((90, 160)))) < 0.2
    assert resemblance(scene, 2.0, own[:, ::-1]) < ALIKE


def test_a_uniform_picture_says_nothing():
    assert resemblance(labelled_scene(), 0.0, np.zeros((20, 30))) == 0.0
