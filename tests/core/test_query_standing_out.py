"""How much what moves differs from what is behind it."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.query.blend_weights import blend_weight_sums
from f4x_core.query.standing_out import DARKEST, between, difference, unlike
from f4x_core.scene import Scene
from f4x_core.scene.view import render

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("light", [1.0, 0.6, DARKEST])
def test_the_same_and_its_shadow_do_not_differ(light):
    wall = RNG.uniform(0.2, 1, (9, 12, 3))
    np.testing.assert_allclose(unlike(light * wall, wall), 0, atol=1e-12)


def test_what_is_darker_than_a_shadow_lighter_or_of_another_colour_differs():
    wall = np.full((5, 6, 3), 0.5)
    np.testing.assert_allclose(unlike(0 * wall, wall), DARKEST * 0.5)
    np.testing.assert_allclose(unlike(wall + 0.2, wall), 0.2)
    np.testing.assert_allclose(unlike(np.ones((5, 6, 3)), np.zeros((5, 6, 3))), 1)
    red = wall + np.array([0.2, -0.2, 0])  # as light as the wall, 0.6 more red than green by the eye's weights
    np.testing.assert_allclose(unlike(red, wall), 0.6)


def test_texture_differs_though_the_mean_does_not():
    wall = np.full((8, 8, 3), 0.5)
    checks = wall + 0.1 * (-1) ** np.add.outer(np.arange(8), np.arange(8))[..., None]
    assert unlike(checks, wall)[1:-1, 1:-1].min() > 0.08


def test_numbers_beyond_the_picture_are_cut():
    wall = RNG.uniform(0, 1, (4, 4, 3))
    np.testing.assert_array_equal(unlike(wall + 3, wall - 3), unlike(np.ones_like(wall), np.zeros_like(wall)))
    assert np.isfinite(unlike(np.zeros_like(wall), np.zeros_like(wall))).all()


def test_sums_are_those_of_the_views():
    scene = labelled_scene(features=False)
    weights, differences = difference(scene, 2, 40)
    still, cameras = Scene("wall", scene.static, scene.cameras), scene.cameras
    rows = round(40 * cameras.height / cameras.width)
    expected = np.zeros((2, len(scene.ids)))
    for frame in (0, len(cameras) - 1):
        time, camera = float(cameras.times[frame]), cameras[frame].resized(40, rows)
        wall, here = (render(part, camera, time, ("rgb", "alpha")) for part in (still, scene))
        differs = np.where(wall["alpha"] > 0.9, unlike(here["rgb"], wall["rgb"]), 1)
        layers = np.stack([np.ones_like(differs), differs], -1).astype(np.float32)
        expected += blend_weight_sums(scene, time, frame, layers).T / 2
    scale = cameras.width * cameras.height / (40 * rows)
    np.testing.assert_allclose(weights, scale * expected[0], rtol=1e-6)
    np.testing.assert_allclose(differences, scale * expected[1], rtol=1e-6)
    assert differences[scene.moving].sum() > 0.5 * weights[scene.moving].sum()


def test_where_no_background_is_known_all_differs():
    scene = labelled_scene(features=False)
    alone = replace(scene, static=scene.static.take(np.zeros(len(scene.static), bool)))
    weights, differences = difference(alone, 2, 40)
    np.testing.assert_allclose(differences, weights)


def test_between_is_what_has_the_thing_above_and_below():
    """Of a square, the upper and the lower third are given: what lies between them is held, and nothing beside it."""
    scene = labelled_scene(features=False)
    height = scene.posed(0.0).means[:, 1]
    low, high = np.quantile(height[scene.moving], [1 / 3, 2 / 3])
    ends = scene.moving & ((height < low) | (height > high))
    middle = scene.moving & (height > low + 0.2 * (high - low)) & (height < high - 0.2 * (high - low))
    weights, parts = between(scene, ends, 2, 120)
    assert parts[middle].sum() > 0.95 * weights[middle].sum() > 0
    upper = scene.moving & (height < low)
    assert between(scene, upper, 2, 120)[1][middle].sum() < 0.05 * weights[middle].sum()
    assert parts[~scene.moving].sum() < 0.1 * weights[~scene.moving].sum()
