"""Moving Gaussians go where the refined outlines of a thing put them: what looks like the wall behind is no part of it."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.apply import edited, with_operations
from f4x_core.edit.operations import Duplicate, Recolour
from f4x_core.edit.selects import Ids
from f4x_core.geometry import spherical_harmonics
from f4x_core.query.outlines import within_outlines
from f4x_core.query.prompts import select_by_points
from f4x_core.scene import Scene

WALL = (0.2, 0.3, 0.8)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The red square with its lower third in the wall's color."""
    plain = labelled_scene(features=False)
    sh = plain.dynamic.sh.copy()
    sh[plain.dynamic.means[:, 1] > 0.04] = spherical_harmonics.dc_from_rgb(np.float32(WALL))
    return replace(plain, dynamic=replace(plain.dynamic, sh=sh))


def parts_of(scene):
    """(red, as the wall), (N,) bool: the moving Gaussians by their color, without the row in between."""
    red, wall = np.zeros((2, len(scene.ids)), bool)
    red[scene.moving], wall[scene.moving] = scene.dynamic.means[:, 1] < 0.04, scene.dynamic.means[:, 1] > 0.07
    return red, wall


def within(part, whole):
    """The fraction of the Gaussians `whole` that `part` has."""
    return (part & whole).sum() / whole.sum()


def test_what_looks_like_the_wall_is_left_out(scene):
    red, wall = parts_of(scene)
    found = within_outlines(scene, scene.moving.astype(float)) > 0.5
    assert within(found, wall) < 0.2 and within(found, red) > 0.9 and not found[~scene.moving].any()


def test_what_lies_inside_is_added(scene):
    red, _ = parts_of(scene)
    middle = np.zeros(len(red), bool)
    middle[scene.moving] = np.hypot(scene.dynamic.means[:, 0] + 0.2, scene.dynamic.means[:, 1] + 0.04) < 0.03
    assert middle.any()
    found = within_outlines(scene, (red & ~middle).astype(float))
    assert (found[middle] == 1).all()


def test_a_click_takes_the_thing_alone(scene):
    red, wall = parts_of(scene)
    pixels, _ = scene.cameras[0].project(scene.posed(0.0).means[red].mean(0))
    found = select_by_points(scene, pixels[None], 0).chosen
    assert within(found, red) > 0.9 and within(found, wall) < 0.2


@pytest.mark.parametrize("kind", ["static", "as the wall"])
def test_a_thing_of_which_most_would_be_lost_stays(scene, kind):
    chosen = ~scene.moving if kind == "static" else parts_of(scene)[1]
    np.testing.assert_array_equal(within_outlines(scene, 0.8 * chosen), 0.8 * chosen)


def test_scores_of_others_stay(scene):
    scores = np.where(scene.moving, 0.9, 0.3)
    found = within_outlines(scene, scores)
    assert (found[~scene.moving] == 0.3).all() and set(np.unique(found[scene.moving])) == {0, 0.9}


def test_edits_do_not_change_the_outlines(scene):
    expected = within_outlines(scene, scene.moving.astype(float))
    red = Ids.of(scene.ids[parts_of(scene)[0]])
    hidden = edited(with_operations(scene, Recolour(red, WALL)))
    np.testing.assert_array_equal(within_outlines(hidden, scene.moving.astype(float)), expected)


def test_of_a_copy_the_same_is_left_out_and_nothing_is_added(scene):
    red, _ = parts_of(scene)
    twice = edited(with_operations(scene, Duplicate(Ids.of(scene.ids[scene.moving]), (0.0, 0.3, 0.0))))
    copy = np.arange(len(twice.ids)) >= len(scene.ids)
    assert copy.sum() == scene.moving.sum()
    found = within_outlines(twice, copy.astype(float)) > 0.5
    assert not found[~copy].any()
    assert within(found, copy & red[twice.origin]) > 0.9 and found.sum() < 0.8 * copy.sum()
