"""Mattes are refined along outlines: by colours near them, by the background behind and along edges."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene, square_mask

from f4x_core.geometry.trajectory import View
from f4x_core.query import matte
from f4x_core.query.matte import matte_image, refine_matte
from f4x_core.query.pixels import coverage_image
from f4x_core.query.prompts import select_by_text
from f4x_core.query.score import overlap
from f4x_core.scene import Scene
from f4x_core.scene.clouds import Cloud
from f4x_core.scene.exposure import Exposure, Take, shoot
from f4x_core.scene.stage import DrawSettings
from f4x_core.scene.view import render

SHAPE = (120, 480)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
DISC = (X - 200) ** 2 + (Y - 60) ** 2 < 40**2
NOISE = np.random.default_rng(0).normal(size=(*SHAPE, 3))
RED, GREEN = np.array([0.7, 0.3, 0.3]), np.array([0.3, 0.5, 0.3])
PICTURE = np.where(DISC[..., None], RED, GREEN) + 0.04 * NOISE


def shifted(pixels):
    """Coverage of a disc that lies so many pixels beside the one in the picture, with an edge of three."""
    far = np.hypot(X - 200 - pixels, Y - 60) - 40
    return np.clip(0.5 - far / 3, 0, 1).astype(np.float32)


@pytest.mark.parametrize("pixels", [-3, 0, 3])
def test_the_outline_goes_to_the_edge_of_colours(pixels):
    found = refine_matte(shifted(pixels), PICTURE)
    assert overlap(found > 0.5, DISC) > 0.96 and overlap(shifted(3) > 0.5, DISC) < 0.92
    assert found.dtype == np.float32 and found.min() >= 0 and found.max() <= 1


def test_only_a_band_around_the_outline_changes():
    coverage = np.minimum(shifted(2), 0.8)
    found = refine_matte(coverage, PICTURE)
    far = abs(np.hypot(X - 202, Y - 60) - 40) > 4 * np.sqrt(2) + 1
    np.testing.assert_array_equal(found[far], coverage[far])
    assert (found != coverage).any()


@pytest.mark.parametrize("value", [0.0, 0.3, 0.9])
def test_without_an_outline_nothing_is_refined(value):
    coverage = np.full(SHAPE, value, np.float32)
    assert refine_matte(coverage, PICTURE) is coverage


def test_a_plain_picture_leaves_what_is_covered():
    plain = np.full((*SHAPE, 3), 0.5)
    assert overlap(refine_matte(shifted(0), plain) > 0.5, DISC) > 0.98


def test_what_is_as_the_background_behind_is_no_part():
    """Colours tell nothing here: a disc of the same mixture of colours as the ground, whose picture behind is known."""
    ground = 0.5 + 0.15 * NOISE
    picture = np.where(DISC[..., None], ground[::-1], ground)
    behind = np.concatenate([ground, np.ones((*SHAPE, 1))], -1)
    told, unknown = (
        refine_matte(shifted(3), picture, np.concatenate([ground, np.full((*SHAPE, 1), alpha)], -1))
        for alpha in (1.0, 0.5)
    )
    np.testing.assert_array_equal(refine_matte(shifted(3), picture, behind), told)
    np.testing.assert_array_equal(refine_matte(shifted(3), picture), unknown)
    assert overlap(told > 0.5, DISC) > overlap(unknown > 0.5, DISC) + 0.02


def test_sums_over_windows_by_loops():
    values = np.random.default_rng(1).random((5, 7, 2))
    for reach in (0, 1, 4):
        found = matte._sums(values, reach)
        for y, x in np.ndindex(5, 7):
            window = values[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            np.testing.assert_allclose(found[y, x], window.sum((0, 1)), rtol=1e-5)


def test_the_matte_of_a_moving_square():
    scene = labelled_scene()
    found = select_by_text(scene, ["square"])
    for time in (0.0, 2.5):
        camera = scene.cameras.at(time)
        own, plain = matte_image(scene, found, camera, time), coverage_image(scene, found, camera, time)
        assert own.shape == plain.shape and overlap(own > 0.5, square_mask(time)) > 0.9
    assert not matte_image(scene, found.within(2, 3), scene.cameras[0], 0.0).any()


def test_the_background_is_the_scene_without_what_moves():
    scene = labelled_scene()
    view = View(scene.cameras[1], 1.0)
    still = render(Scene("still", scene.static, scene.cameras), *view, ("rgb", "alpha"))
    found = matte.background_of(scene, view, "auto")
    np.testing.assert_allclose(found, np.dstack([still["rgb"], still["alpha"]]), atol=1e-5)


def test_mattes_of_a_picture_are_refined_and_share_what_is_covered():
    """Two clouds, as Blender has them: what the moving one gives up goes to the one behind it, and nothing to a third."""
    scene, time = labelled_scene(), 2.0
    camera, whole = scene.cameras[2], Cloud.of_scene(labelled_scene(), 2.0)
    still = Cloud.of_scene(Scene("still", scene.static, scene.cameras), time)
    aside = replace(still, to_world=np.diag([1.0, 1.0, -1.0, 1.0]))
    moving = {
        name: getattr(whole, name)[scene.moving] for name in ("means", "quats", "scales", "opacities", "sh", "turn")
    }
    clouds = [
        replace(still, mattes={"object": np.full(len(still.means), 7, np.uint32)}),
        replace(whole, **moving, mattes={"object": np.full(scene.moving.sum(), 5, np.uint32)}),
        replace(aside, mattes={"object": np.full(len(aside.means), 9, np.uint32)}),
    ]
    clouds[1] = replace(clouds[1], layers={matte.MOVES: np.ones((scene.moving.sum(), 1), bool)})
    settings, take = DrawSettings(), Take(clouds, [], camera)
    plain = shoot(lambda offset: take, Exposure(), settings, ["alpha", matte.OBJECTS])
    found = shoot(
        lambda offset: take, Exposure(), settings, ["alpha", matte.OBJECTS],
        refine=lambda images, take: matte.refine_passes(images, take, settings, [5, 6]),
    )  # fmt: skip
    own, behind, other = (f"{matte.OBJECTS}:{number:08x}" for number in (5, 7, 9))
    expected = matte.mattes(scene, scene.moving[:, None], View(camera, time))[..., 0]
    np.testing.assert_allclose(found[own], np.minimum(expected, plain["alpha"]), atol=1e-4)
    assert np.abs(found[own] - plain[own]).max() > 0.1
    np.testing.assert_allclose(found[own] + found[behind] + found[other], plain["alpha"], atol=1e-4)
    assert np.abs(found[other]).max() < 1e-4
    assert matte.refine_passes(plain, take, settings, [6]) == {}


def test_what_is_blurred_is_not_refined():
    scene = labelled_scene()
    take = Take([Cloud.of_scene(scene, 0.0)], [], scene.cameras[0])
    shoot(
        lambda offset: take,
        Exposure(2, 0.0, 1.0),
        DrawSettings(),
        ["alpha"],
        refine=lambda *given: pytest.fail("blurred"),
    )


def test_what_looks_like_the_background_within_the_outline_is_in_doubt():
    """A hole of the ground's own texture far inside of a covered disc: gone where the ground is known, and only there."""
    hole = np.hypot(X - 200, Y - 60) < 20
    ground = np.clip(GREEN + 0.04 * NOISE, 0, 1)
    picture = np.where((DISC & ~hole)[..., None], RED + 0.04 * NOISE, ground)
    known, unknown = (
        refine_matte(shifted(0), picture, np.concatenate([ground, np.full((*SHAPE, 1), alpha)], -1)) > 0.5
        for alpha in (1.0, 0.5)
    )
    assert known[hole].mean() < 0.1 and unknown[hole].all()
    assert known[DISC & ~hole].mean() > 0.95
