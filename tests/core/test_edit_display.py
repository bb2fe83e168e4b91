"""What a viewer has to draw of an edited scene: which rows apart, when anew, and in which looks."""

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.apply import with_operations
from f4x_core.edit.display import Display, by_score
from f4x_core.edit.operations import Delete, Duplicate, Freeze, Recolour, Transform
from f4x_core.edit.selects import Ids, Moving
from f4x_core.query.prompts import select_by_text
from f4x_core.scene.tints import with_tints

SCENE = labelled_scene()
STILL = Ids.of(SCENE.static.ids[:10])
RED = {"rgb": (1.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("operations", "apart", "changes"),
    [
        ((), 0, False),
        ((Recolour(Moving(), **RED),), 0, False),
        ((Recolour(Moving(), **RED, frames=(1, 3)),), 0, True),
        ((Transform(STILL, (0, 0, 1)),), 10, False),
        ((Transform(STILL, (0, 0, 1), frames=(1, 3)),), 10, True),
        ((Duplicate(STILL, (0, 0, 1)),), 20, False),
        ((Freeze(Moving(), 2),), len(SCENE.dynamic), True),
        ((Transform(STILL, (0, 0, 1)), Delete(STILL)), 0, False),
    ],
)
def test_what_is_drawn_apart_and_when(operations, apart, changes):
    scene = with_operations(SCENE, *operations) if operations else SCENE
    display = Display(scene)
    assert (len(display.apart), display.changes) == (apart, changes)
    if apart:
        whole, part = scene.posed(2.5), display.moment(2.5)
        for name, array in whole.arrays().items():
            np.testing.assert_array_equal(array[display.apart], getattr(part, name))
    np.testing.assert_array_equal(display.appearance(2.5).sh, scene.posed(2.5).sh)


@pytest.mark.parametrize(
    ("operation", "changes"),
    [
        (Transform(STILL, (0, 0, 1)), False),
        (Duplicate(STILL, (0, 0, 1)), False),
        (Duplicate(STILL, (0, 0, 1), time_shift=1.0), True),
        (Freeze(STILL, 2), True),
    ],
)
def test_with_colors_over_time_what_shows_other_moments_is_drawn_at_every_frame(operation, changes):
    tints = np.ones((len(SCENE.ids), 2, 3), np.int8)
    assert Display(with_operations(with_tints(SCENE, [0.0, 5.0], tints), operation)).changes == changes


def test_a_recolored_gaussian_has_tints_by_its_new_color():
    display = Display(with_operations(SCENE, Recolour(STILL, (0.0, 1.0, 0.0), "multiply", 1.0)))
    gain = display.tint_gain(display.appearance(0.0))
    np.testing.assert_allclose(gain[:10], np.tile([0, 1, 0], (10, 1)), atol=1e-5)
    assert (gain[10:] == 1).all()


def test_equal_keys_mean_equal_looks():
    display = Display(with_operations(SCENE, Recolour(Moving(), **RED, frames=(1, 3))))
    assert display.appearance_key(0) == display.appearance_key(5) != display.appearance_key(2)
    np.testing.assert_array_equal(display.appearance(0).sh, display.appearance(5).sh)
    assert np.abs(display.appearance(0).sh - display.appearance(2).sh).max() > 0.1


def test_a_copy_is_asked_as_its_original():
    scene = with_operations(SCENE, Duplicate(Moving(), (0, 0, 0.3)))
    found = Display(scene).of_base(select_by_text(SCENE, ["square"]))
    assert set(found.chosen_ids) == set(scene.ids[scene.moving])
    row, known = Display(scene).rows_of(np.array([int(scene.ids[-1]), 10**6, int(scene.ids[0])]))
    assert known.tolist() == [True, False, True] and scene.ids[row[[0, 2]]].tolist() == [scene.ids[-1], scene.ids[0]]


def test_scores_become_colours_alone():
    looks = Display(SCENE).appearance(0)
    shown = by_score(looks, np.linspace(0, 1, len(looks.sh)))
    assert shown.opacities is looks.opacities and shown.sh.shape == looks.sh.shape
    assert np.abs(np.diff(shown.sh[:, 0], axis=0)).max() < 0.1 and np.ptp(shown.sh[:, 0], axis=0).min() > 0.5
