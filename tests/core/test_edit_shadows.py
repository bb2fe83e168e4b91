"""Removing, hiding or moving a thing takes along its shadow and its loose edges, and nobody else's."""

import numpy as np
import pytest
from two_shadows import two_with_shadows

from f4x_core.edit.apply import edited, with_operations
from f4x_core.edit.description import describe
from f4x_core.edit.operations import (
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Loop,
    Opacity,
    Recolour,
    Retime,
    Reverse,
    Transform,
    read_operation,
)
from f4x_core.edit.plan import propose
from f4x_core.edit.plan_lines import plan_lines
from f4x_core.edit.resolve import EditorState, resolve, rows_of
from f4x_core.edit.selects import And, Ids, Not, Text
from f4x_core.edit.which import asked_about
from f4x_core.query.attached import attached_to
from f4x_core.query.cast import cast_of
from f4x_core.query.selection import Selection
from f4x_core.scene.view import render

SCENE, SQUARE, SHADOW, OTHER, OTHER_SHADOW = two_with_shadows()
IDS = Ids.of(SCENE.ids[SQUARE])
STATE = EditorState(Selection(SCENE.ids, SQUARE.astype(float), np.zeros(len(SQUARE), bool)))
CAR = Text(("car",), single=("car",))
MOST = 0.7
"""Of a shadow's Gaussians, those that the graph calls cast at least."""


def along(operation, scene=SCENE):
    """(N,) bool: what goes along with an operation that is planned."""
    found = resolve(scene, operation, EditorState()).along
    return np.isin(scene.ids, [] if found is None else found.array)


def drawn(scene, frame=1):
    return render(scene, scene.cameras[frame], float(scene.cameras.times[frame]), ("rgb",))["rgb"]


@pytest.mark.parametrize(
    "operation",
    [Delete(IDS), Opacity(IDS, 0.0), Transform(IDS, (0.3, 0.0, 0.0)), Duplicate(IDS, (0.3, 0.0, 0.0)), Freeze(IDS, 1.0),
     Retime(IDS, 0.5), Reverse(IDS), Loop(IDS, (0.0, 1.0))],
    ids=lambda operation: operation.TAG,
)  # fmt: skip
def test_its_own_shadow_goes_along(operation):
    found = along(operation)
    assert found[SHADOW].mean() > MOST and not found[~SHADOW].any()
    assert " with its shadow" in describe(resolve(SCENE, operation, EditorState()))


def test_the_picture_is_as_if_it_had_never_been_there():
    clean = drawn(with_operations(SCENE, Delete(Ids.of(SCENE.ids[SQUARE | SHADOW]))))
    without = drawn(with_operations(SCENE, resolve(SCENE, Delete(IDS), EditorState())))
    thing_alone = drawn(with_operations(SCENE, Delete(IDS)))
    assert np.abs(without - clean).mean() < 0.35 * np.abs(thing_alone - clean).mean()
    half = SCENE.cameras.width // 2
    np.testing.assert_array_equal(without[:, half:], drawn(SCENE)[:, half:])  # the other one is untouched


def test_what_is_shown_again_has_its_shadow_again():
    scene = SCENE
    for sentence in ("hide it", "show it again"):
        scene = with_operations(scene, *propose(scene, sentence, STATE).chosen.operations)
    np.testing.assert_array_equal(drawn(scene), drawn(SCENE))
    removed = with_operations(
        SCENE, Delete(Ids.of(SCENE.ids[SHADOW])), resolve(SCENE, Opacity(IDS, 0.0), EditorState())
    )
    assert not along(Opacity(IDS, 10.0), edited(removed))[SHADOW].any()  # what is gone for good stays gone


@pytest.mark.parametrize(
    "operation", [Recolour(IDS, (1.0, 0.0, 0.0)), Extract(IDS)], ids=lambda operation: operation.TAG
)
def test_colors_leave_the_shadow_alone(operation):
    assert resolve(SCENE, operation, EditorState()) == operation


@pytest.mark.parametrize(
    ("sentence", "gone", "stays"),
    [
        ("remove it", SQUARE | SHADOW, OTHER | OTHER_SHADOW),
        ("remove it with its shadow", SQUARE | SHADOW, OTHER),
        ("hide it", SQUARE | SHADOW, OTHER | OTHER_SHADOW),
        ("remove it but keep its shadow", SQUARE, SHADOW | OTHER | OTHER_SHADOW),
        ("remove it without its shadow", SQUARE, SHADOW | OTHER | OTHER_SHADOW),
        ("remove it but keep the reflection", SQUARE, SHADOW | OTHER | OTHER_SHADOW),
        ("remove the shadow", SHADOW | OTHER_SHADOW, SQUARE | OTHER),
        ("remove the shadows", SHADOW | OTHER_SHADOW, SQUARE | OTHER),
    ],
)
def test_sentences_do_what_they_say(sentence, gone, stays):
    operations = propose(SCENE, sentence, STATE).chosen.operations
    left = edited(with_operations(SCENE, *operations)).posed(1.0).opacities > 0
    assert left[gone].mean() < 1 - MOST and left[stays].all()


def test_a_shadow_stays_on_the_ground_below_what_is_lifted_and_where_it_is_told_to():
    assert not along(Transform(IDS, (0.0, -0.5, 0.1))).any()
    assert not along(Delete(IDS, along=Ids())).any()
    assert not along(Delete(Ids.of(SCENE.ids[SHADOW]))).any()  # a shadow has none of its own


def test_loose_edges_go_along_and_a_half_does_not_take_the_other_half():
    x, y, _ = SCENE.posed(0.0).means.T
    corner = SQUARE & (x + y < np.quantile((x + y)[SQUARE], 0.03))
    most, left = SQUARE & ~corner, SQUARE & (x < np.median(x[SQUARE]))
    assert corner.any()
    assert along(Delete(Ids.of(SCENE.ids[most])))[corner].all()
    assert along(Delete(Ids.of(SCENE.ids[left])))[SQUARE].mean() < 0.1


def test_the_pivot_is_that_of_the_thing():
    turned = resolve(SCENE, Transform(IDS, rotate=(0.0, 90.0, 0.0)), EditorState())
    alone = with_operations(SCENE, Transform(IDS, rotate=(0.0, 90.0, 0.0))).posed(1.0).means
    np.testing.assert_array_equal(with_operations(SCENE, turned).posed(1.0).means[SQUARE], alone[SQUARE])


def test_copies_have_shadows_and_leave_the_originals_theirs():
    copied = with_operations(SCENE, resolve(SCENE, Duplicate(IDS, (0.0, -1.0, 0.0)), EditorState()))
    assert len(copied.ids) - len(SCENE.ids) > SQUARE.sum() + MOST * SHADOW.sum()
    assert along(Delete(IDS), copied)[: len(SHADOW)][SHADOW].mean() > MOST


def test_stacks_from_before_mean_what_they_meant():
    old = read_operation({"op": "delete", "select": {"by": "ids", "ids": SCENE.ids[SQUARE].tolist()}})
    left = with_operations(SCENE, old)
    np.testing.assert_array_equal(left.gone, SQUARE)
    planned = resolve(SCENE, old, EditorState())
    assert read_operation(planned.to_json()) == planned != old
    assert len(rows_of(left, planned.along)) == along(old).sum()


def test_each_has_its_own():
    for thing, shadow in ((SQUARE, SHADOW), (OTHER, OTHER_SHADOW)):
        found = attached_to(SCENE, thing)
        assert found.shadow[shadow].mean() > MOST and not found.shadow[~shadow].any() and not found.edges.any()
        np.testing.assert_array_equal(cast_of(SCENE, thing) > 0, found.shadow)
    both = attached_to(SCENE, SQUARE | OTHER)
    np.testing.assert_array_equal(both.shadow, cast_of(SCENE) > 0)
    none = attached_to(SCENE, ~SCENE.moving)
    assert not none.shadow.any() and not none.edges.any()


def test_a_sentence_that_keeps_the_shadow_can_be_undone_by_a_sentence():
    sentence = "remove it but keep its shadow"
    removed = with_operations(SCENE, *propose(SCENE, sentence, STATE).chosen.operations, sentence=sentence)
    taken_back = propose(removed, "undo that", STATE).chosen.operations
    assert not edited(with_operations(removed, *taken_back)).rows.gone.any()


def test_the_shadow_that_stays_does_not_say_which_of_several_is_meant():
    (plain,), (kept,) = (list(asked_about(Delete(select))) for select in (CAR, And((CAR, Not(Text(("shadow",)))))))
    assert plain == kept


def test_a_plan_counts_the_shadow_that_goes_along():
    planned = resolve(SCENE, Delete(IDS), EditorState())
    (line,) = plan_lines(SCENE, [planned])
    both = (SQUARE | along(Delete(IDS))).mean()
    assert f"({both:.0%} of".replace("%", " %") in line
