"""Loose edges that stand out belong to a thing, and a mask decides what it shows clearly."""

from dataclasses import replace

import numpy as np
import pytest
from two_shadows import two_with_shadows

from f4x_core.edit.apply import with_operations
from f4x_core.edit.operations import Duplicate
from f4x_core.edit.selects import Moving
from f4x_core.query.cast import cast_of, without_shadow
from f4x_core.query.marks import Mask, Point
from f4x_core.query.objects import graph_of
from f4x_core.query.prompts import SelectOptions, select_by_evidence, select_by_mask
from f4x_core.query.select_config import SELECT

SCENE, SQUARE, SHADOW, OTHER, OTHER_SHADOW = two_with_shadows()
MOVING = graph_of(SCENE).moving
COUNT = len(SCENE.ids)


def superpoints_of(rows):
    return MOVING.means(rows.astype(float), np.ones(COUNT)) > 0.5


@pytest.mark.parametrize("refused", [False, True])
def test_what_stands_out_beside_a_thing_belongs_to_it(refused):
    """A corner that a search left out comes back, unless it was marked as not meant; nothing of the other square does."""
    x, y, _ = SCENE.posed(0.0).means.T
    lost = superpoints_of(SQUARE & (x + y < np.quantile((x + y)[SQUARE], 0.03)))
    assert lost.any()
    thing = superpoints_of(SQUARE) & ~lost
    found = MOVING.with_edges(thing, lost & refused, COUNT) > 0
    assert found[SQUARE].all() != refused and not found[SHADOW | OTHER | OTHER_SHADOW].any()
    blind = replace(MOVING, config=replace(SELECT, thing=replace(SELECT.thing, stands_out=2.0)))
    assert not blind.with_edges(thing, lost & refused, COUNT)[SQUARE].all()


def test_of_a_shadow_nothing_else_is_taken():
    shadow = superpoints_of(SHADOW) & MOVING.cast
    np.testing.assert_array_equal(
        MOVING.with_edges(shadow, np.zeros(len(shadow), bool), COUNT), MOVING.spread(shadow.astype(float), COUNT)
    )


@pytest.mark.parametrize("on_the_graph", [False, True])
def test_a_mask_decides_what_it_shows_clearly(on_the_graph):
    """A mask of the square without its left columns, which a search by looks would take."""
    frame = 2
    camera, posed = SCENE.cameras[frame], SCENE.posed(float(frame))
    pixels = camera.project(posed.means)[0]
    mask = np.zeros((SCENE.cameras.height, SCENE.cameras.width), bool)
    x, y = np.floor(pixels[SQUARE]).astype(int).T
    mask[y.min() - 3 : y.max() + 4, x.min() + 3 : x.max() + 4] = True
    options = SelectOptions(config=replace(SELECT, thing=replace(SELECT.thing, seen=0.3)))

    def found():
        if on_the_graph:
            return select_by_evidence(SCENE, [Mask(frame, True, mask)], options=options).chosen
        return select_by_mask(SCENE, mask, frame, options).chosen

    left_out = SQUARE & (pixels[:, 0] < x.min() + 1.5)
    inside = SQUARE & (pixels[:, 0] > x.min() + 5)
    assert left_out.any() and not found()[left_out].any() and found()[inside].all()


def test_a_mark_on_what_is_not_meant_is_stronger_than_a_mask():
    frame = 2
    x, y = SCENE.cameras[frame].project(SCENE.posed(float(frame)).means)[0].T
    mask = np.zeros((SCENE.cameras.height, SCENE.cameras.width), bool)
    for square in (SQUARE, OTHER):
        mask[int(y[square].min()) : int(y[square].max()) + 1, int(x[square].min()) : int(x[square].max()) + 1] = True
    middle = (float(np.median(x[OTHER])), float(np.median(y[OTHER])))
    both = select_by_evidence(SCENE, [Mask(frame, True, mask)]).chosen
    one = select_by_evidence(SCENE, [Mask(frame, True, mask), Point(frame, False, middle)]).chosen
    assert both[SQUARE].mean() > 0.8 and both[OTHER].mean() > 0.8
    assert one[SQUARE].mean() > 0.8 and one[OTHER].mean() < both[OTHER].mean()


def test_words_and_masks_leave_out_what_looks_like_the_background():
    scores = (SQUARE | SHADOW).astype(float)
    left = without_shadow(SCENE, scores)
    cast = cast_of(SCENE) > 0
    assert (left[SQUARE] == 1).all() and left[SHADOW & cast].mean() < 0.7 and (left[SHADOW & ~cast] == 1).all()
    np.testing.assert_array_equal(without_shadow(SCENE, SHADOW.astype(float)), SHADOW)  # a shadow is meant
    still = (~SCENE.moving).astype(float)
    assert without_shadow(SCENE, still) is still


def test_copies_are_told_from_shadows_as_their_originals_are():
    moved = with_operations(SCENE, Duplicate(Moving(), (0.0, 0.5, 0.0)))
    scores = np.concatenate([(SQUARE | SHADOW).astype(float), (SQUARE | SHADOW)[SCENE.moving]])
    left = without_shadow(moved, scores)
    np.testing.assert_array_equal(left[: len(SCENE.ids)], without_shadow(SCENE, (SQUARE | SHADOW).astype(float)))
    np.testing.assert_array_equal(left[len(SCENE.ids) :], left[: len(SCENE.ids)][SCENE.moving])
