"""Edits against plain restatements: what changes, what stays to the bit, at which time, in which order."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from edit_cases import looks_operations, stacks
from hypothesis import given, settings
from labelled_scene import labelled_scene
from random_scene import arrays_of, assert_same, random_scene

from f4x_core.edit.apply import KEPT_MOMENTS, base_of, edited, next_id, open_scene, pivot_of, with_operations
from f4x_core.edit.colours import colours_of, lab_from_rgb, rgb_from_lab
from f4x_core.edit.operations import (
    SHOWN,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Grade,
    Loop,
    Match,
    Name,
    Opacity,
    Recolour,
    Retime,
    Reverse,
    Style,
    Transform,
)
from f4x_core.edit.selects import All, Ids, Moving, Named, Not, Point, Text
from f4x_core.edit.stack import EditStack, of, with_stack
from f4x_core.edit.styles import STYLES
from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion
from f4x_core.query.prompts import select_by_text
from f4x_core.scene import write_scene
from f4x_core.scene.view import render

SCENE = random_scene(degree=2)
MOVING = np.arange(50) >= 30
SOME = Ids.of(np.array([3, 4, 31, 40]))
SOME_ROWS = np.isin(np.arange(50), [3, 4, 31, 40])
TIMES = (0.0, 1.5, 2.0, 5.0)


def assert_posed_equal(a, b, names=None):
    for name in names or a.arrays():
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def rows(posed, index):
    return posed.take(index)


def test_a_scene_without_edits_is_that_scene():
    assert edited(SCENE) is SCENE
    e = with_operations(SCENE, Delete(SOME))
    assert edited(e) is e and type(base_of(e)) is type(SCENE)


def test_delete_then_undo_is_bit_identical():
    before = arrays_of(SCENE)
    e = with_operations(SCENE, Delete(SOME))
    assert (e.posed(1.0).opacities[SOME_ROWS] == 0).all()
    assert_posed_equal(rows(e.posed(1.0), ~SOME_ROWS), rows(SCENE.posed(1.0), ~SOME_ROWS))
    back = edited(with_stack(base_of(e), of(e).undo()))
    for time in TIMES:
        assert_posed_equal(back.posed(time), SCENE.posed(time))
    assert all(before[name] is array for name, array in arrays_of(back).items())  # not even copied


@settings(max_examples=60, deadline=None)
@given(stacks)
def test_random_stacks_keep_rows_arrays_and_come_back(listed):
    e = with_operations(SCENE, *listed)
    for time in TIMES:
        posed = e.posed(time)
        assert_posed_equal(posed, e.posed(time))
        np.testing.assert_array_equal(posed.ids, e.ids)
        assert len(np.unique(posed.ids)) == len(posed.ids) == len(posed.means) == len(posed.sh)
        assert all(np.isfinite(part).all() for part in posed.arrays().values())
        assert (posed.opacities >= 0).all() and (posed.opacities <= 1).all() and (posed.scales >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(posed.quats, axis=1), 1, atol=1e-5)
        still = ~posed.dynamic
        np.testing.assert_array_equal(posed.means[still], e.posed(0.0).means[still])  # only what moves is said to move
        assert posed.means.dtype == posed.sh.dtype == posed.opacities.dtype == posed.scales.dtype == np.float32
    stack = of(e)
    assert of(edited(with_stack(base_of(e), stack))) == stack
    assert json.loads(json.dumps(stack.to_json())) == json.loads(json.dumps(list(e.edits)))
    for _ in listed:
        stack = stack.undo()
    back = edited(with_stack(base_of(e), EditStack(stack.edits)))
    assert_same(back, SCENE)
    assert_posed_equal(back.posed(1.5), SCENE.posed(1.5))


@settings(max_examples=60, deadline=None)
@given(stacks, looks_operations)
def test_one_more_edit_acts_on_what_the_others_left(listed, last):
    """state(k, t) is the last operation on state(k-1, t): colours of whom it does not choose stay to the bit."""
    before, after = with_operations(SCENE, *listed), with_operations(SCENE, *listed, last)
    for time in TIMES:
        a, b = before.posed(time), after.posed(time)
        assert_posed_equal(a, b, ("means", "quats", "scales", "ids", "dynamic"))
        chosen = before.rows.chosen(last.select)
        left = chosen if isinstance(last, Extract) else ~chosen
        np.testing.assert_array_equal(a.sh[left], b.sh[left])
        np.testing.assert_array_equal(a.opacities[left], b.opacities[left])


def test_subsets_are_worked_out_as_the_whole_is():
    """Retiming and copying read rows apart; pivots and tones must be those of the whole selection all the same."""
    half = Ids.of(np.arange(30, 40))
    listed = (
        Transform(Moving(), rotate=(0, 50, 0), scale=1.5, frames=(0, 4)),
        Style(Moving(), "gold", frames=(1, 3)),
        Recolour(Moving(), (0, 1, 0), keep_luminance=True, frames=(2, 5)),
    )
    plain = with_operations(SCENE, *listed)
    frozen = with_operations(SCENE, *listed, Freeze(half, 2.5))
    rest = np.isin(SCENE.ids, half.array)
    for time in (1.0, 2.0, 4.0):
        assert_posed_equal(rows(frozen.posed(time), ~rest), rows(plain.posed(time), ~rest))
        assert_posed_equal(rows(frozen.posed(time), rest), rows(plain.posed(min(time, 2.5)), rest))


def test_identity_changes_no_bit():
    for operation in (
        Transform(All()),
        Transform(Moving(), pivot="base"),
        Opacity(All(), 1.0),
        Recolour(All(), (1, 0, 0), strength=0.0),
        Style(All(), "ghost", 0.0),
        Retime(All(), 1.0),
        Name(All(), "x"),
    ):
        for time in (0.0, 2.5):
            assert_posed_equal(
                with_operations(SCENE, operation).posed(time), SCENE.posed(time), [*SCENE.posed(0).arrays()][:6]
            )


def test_transform_moves_posed_gaussians_rigidly_at_all_times():
    pivot, angle, factor, shift = (0.1, 0.2, 2.0), (20.0, 50.0, -10.0), 1.4, (0.3, -0.1, 0.2)
    e = with_operations(SCENE, Transform(SOME, shift, angle, factor, pivot))
    q = quaternion.from_rotation_vector(np.deg2rad(angle))
    matrix = quaternion.to_matrix(q)
    for time in (0.0, 0.7, 3.0, 7.0):
        a, b = SCENE.posed(time), e.posed(time)
        assert_posed_equal(rows(a, ~SOME_ROWS), rows(b, ~SOME_ROWS), ("means", "quats", "scales"))
        want = np.array(pivot) + factor * (a.means[SOME_ROWS] - pivot) @ matrix.T + shift
        np.testing.assert_allclose(b.means[SOME_ROWS], want, atol=1e-6)
        turned = quaternion.to_matrix(quaternion.multiply(q, a.quats[SOME_ROWS].astype(float)))
        np.testing.assert_allclose(quaternion.to_matrix(b.quats[SOME_ROWS].astype(float)), turned, atol=1e-6)
        np.testing.assert_allclose(b.scales[SOME_ROWS], factor * a.scales[SOME_ROWS], rtol=1e-6)
        assert_posed_equal(a, b, ("sh", "opacities", "ids"))  # appearance lives in the Gaussian's own frame


def test_pivots_are_those_of_the_frame():
    e = with_operations(SCENE, Transform(Moving(), rotate=(0, 0, 90)))
    for time in (0.0, 3.3):
        a, b = SCENE.posed(time).means[MOVING], e.posed(time).means[MOVING]
        centre = np.median(a, 0)
        turned = np.stack([-(a - centre)[:, 1], (a - centre)[:, 0], (a - centre)[:, 2]], 1) + centre
        np.testing.assert_allclose(b, turned, atol=1e-5)
    cloud = np.array([[x, y, 3.0] for x in (0, 1, 2) for y in np.linspace(0, 1, 200)])
    np.testing.assert_allclose(pivot_of("base", cloud), [1, 1, 3], atol=0.05)
    np.testing.assert_allclose(pivot_of("centroid", cloud), [1, 0.5, 3], atol=1e-9)


def test_what_is_gone_is_no_part_of_a_pivot():
    far = with_operations(SCENE, Transform(SOME, (500, 0, 0)), Delete(SOME), Transform(All(), rotate=(0, 0, 180)))
    left = ~SOME_ROWS
    means = SCENE.posed(0.0).means[left]
    np.testing.assert_allclose(far.posed(0.0).means[left][:, 0], 2 * np.median(means[:, 0]) - means[:, 0], atol=1e-5)


@pytest.mark.parametrize(
    ("ease", "at", "share"),
    [("linear", 2.5, 0.375), ("smooth", 2.5, 3 * 0.375**2 - 2 * 0.375**3), ("step", 0.9, 0), ("step", 1.0, 1),
     ("linear", 0.0, 0), ("smooth", 5.0, 1), ("linear", 9.0, 1)],
)  # fmt: skip
def test_transform_grows_over_its_span(ease, at, share):
    e = with_operations(SCENE, Transform(SOME, (0.8, 0, 0), (0, 0, 90), 4.0, (0, 0, 0), frames=(1, 5), ease=ease))
    q = quaternion.from_rotation_vector(share * np.deg2rad((0, 0, 90)))
    want = 4.0**share * quaternion.rotate(q, SCENE.posed(at).means[SOME_ROWS].astype(float)) + [0.8 * share, 0, 0]
    np.testing.assert_allclose(e.posed(at).means[SOME_ROWS], want, atol=1e-5)


def test_order_matters_and_edits_compose():
    move, turn = Transform(SOME, (1, 0, 0)), Transform(SOME, rotate=(0, 0, 90), pivot=(0, 0, 0))
    a = with_operations(SCENE, move, turn).posed(1.0).means[SOME_ROWS]
    b = with_operations(SCENE, turn, move).posed(1.0).means[SOME_ROWS]
    x, y, z = SCENE.posed(1.0).means[SOME_ROWS].T
    np.testing.assert_allclose(a, np.stack([-y, x + 1, z], 1), atol=1e-6)
    np.testing.assert_allclose(b, np.stack([-y + 1, x, z], 1), atol=1e-6)


def test_recolour_changes_only_selected_dc():
    base = random_scene(degree=0)
    e = with_operations(base, Recolour(SOME, (1.0, 0.25, 0.0)))
    a, b = base.posed(1.0), e.posed(1.0)
    assert_posed_equal(a, b, [name for name in a.arrays() if name != "sh"])
    np.testing.assert_array_equal(a.sh[~SOME_ROWS], b.sh[~SOME_ROWS])
    np.testing.assert_allclose(colours_of(b.sh[SOME_ROWS]), [[1, 0.25, 0]] * 4, atol=1e-6)


def with_colours(sh):
    """Standing Gaussians of the colours `sh (n,1,3)`, all half transparent."""
    base = random_scene(degree=0, static=len(sh), dynamic=0)
    opacity = np.full(len(sh), 0.5, np.float32)
    return replace(base, static=replace(base.static, sh=sh.astype(np.float32), opacities=opacity))


def colour(*listed, whom=SOME_ROWS, time=0.0):
    return colours_of(with_operations(SCENE, *listed).posed(time).sh[whom])


def test_colour_modes():
    old = colours_of(SCENE.posed(0).sh[SOME_ROWS])
    np.testing.assert_allclose(
        colour(Recolour(SOME, (0.2, -0.1, 0), "add", 0.5)), old + np.array([0.1, -0.05, 0]), atol=1e-6
    )
    np.testing.assert_allclose(colour(Recolour(SOME, (2, 1, 0), "multiply", 0.5)), old * [1.5, 1, 0.5], atol=1e-6)
    np.testing.assert_allclose(colour(Recolour(SOME, (0, 0, 1), strength=0.25)), 0.75 * old + [0, 0, 0.25], atol=1e-6)
    new, target = lab_from_rgb(colour(Recolour(SOME, (0.6, 0.4, 0.3), "hue"))), lab_from_rgb(np.array([0.6, 0.4, 0.3]))
    np.testing.assert_allclose(new[:, 0], np.clip(lab_from_rgb(old)[:, 0], 0, 1), atol=2e-3)
    np.testing.assert_allclose(np.arctan2(new[:, 2], new[:, 1]), math.atan2(target[2], target[1]), atol=0.02)
    grey = colour(Recolour(SOME, (0.5, 0.5, 0.5), "hue"))
    np.testing.assert_allclose(grey, grey[:, :1].repeat(3, 1), atol=1e-3)


def test_multiply_is_light_seen_from_every_side():
    camera = SCENE.cameras[0]
    a, e = SCENE.posed(1.0), with_operations(SCENE, Recolour(All(), (1.5, 0.5, 1.0), "multiply"))
    np.testing.assert_allclose(
        e.colors(e.posed(1.0), camera), SCENE.colors(a, camera) * [1.5, 0.5, 1.0], rtol=1e-4, atol=1e-5
    )


def test_the_assigned_colour_is_seen_from_every_side():
    e = with_operations(SCENE, Recolour(Moving(), (0.9, 0.1, 0.3)))
    for index in (0, 5):
        seen = e.colors(e.posed(2.0), SCENE.cameras[index])[MOVING]
        np.testing.assert_allclose(seen, [[0.9, 0.1, 0.3]] * 20, atol=1e-5)


def test_shading_stays_when_light_is_kept():
    base = random_scene(degree=0, static=400, dynamic=0)
    old = lab_from_rgb(colours_of(base.static.sh))[:, 0]
    e = with_operations(base, Recolour(All(), (0.6, 0.2, 0.2), keep_luminance=True))
    new = lab_from_rgb(colours_of(e.posed(0).sh))
    goal = lab_from_rgb(np.array([0.6, 0.2, 0.2]))
    assert np.corrcoef(old, new[:, 0])[0, 1] > 0.9  # highlights are compressed, no order is changed
    dark = (new[:, 0] > 0.05) & (new[:, 0] < goal[0])
    np.testing.assert_allclose(new[dark, 1:] / new[dark, :1], np.tile(goal[1:] / goal[0], (dark.sum(), 1)), atol=5e-3)
    assert abs(new[:, 0].mean() - goal[0]) < 0.1


@pytest.mark.parametrize("name", STYLES)
def test_looks_are_ramps_of_light(name):
    base = with_colours(np.random.default_rng(0).normal(size=(300, 1, 3)))
    old = lab_from_rgb(colours_of(base.static.sh))[:, 0]
    posed = with_operations(base, Style(All(), name)).posed(0)
    new = colours_of(posed.sh)
    order = np.argsort(old)
    assert (np.diff(lab_from_rgb(new)[order, 0]) > -1e-6).all()  # brighter stays brighter
    low, high = np.array(STYLES[name].ramp)[[0, -1]]
    np.testing.assert_allclose(new[order[[0, -1]]], [low, high], atol=1e-3)
    np.testing.assert_allclose(posed.opacities, base.static.opacities * STYLES[name].opacity, rtol=1e-6)


def test_match_carries_mean_and_spread():
    rng = np.random.default_rng(1)
    base = with_colours(np.concatenate([rng.normal(-0.3, 0.25, (300, 1, 3)), rng.normal(0.3, 0.1, (300, 1, 3))]))
    first, second = Ids.of(np.arange(300)), Ids.of(np.arange(300, 600))
    new = lab_from_rgb(colours_of(with_operations(base, Match(first, second)).posed(0).sh))
    np.testing.assert_allclose(new[:300].mean(0), new[300:].mean(0), atol=0.01)
    np.testing.assert_allclose(new[:300].std(0), new[300:].std(0), rtol=0.15, atol=0.005)


def test_oklab_round_trip_and_known_values():
    rgb = np.random.default_rng(0).random((200, 3))
    np.testing.assert_allclose(rgb_from_lab(lab_from_rgb(rgb)), rgb, atol=1e-5)
    np.testing.assert_allclose(lab_from_rgb(np.ones(3)), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(lab_from_rgb(np.array([1.0, 0, 0])), [0.62796, 0.22486, 0.12585], atol=1e-4)
    too_blue = np.array([[0.8, 0.0, -0.3]])
    shown = lab_from_rgb(rgb_from_lab(too_blue))
    np.testing.assert_allclose(shown[0, 0], 0.8, atol=5e-3)
    assert -0.3 < shown[0, 2] < -0.05 and abs(shown[0, 1]) < 0.01


def test_frames_say_when():
    e = with_operations(SCENE, Opacity(SOME, 0.5, frames=(1, 3)), Delete(Not(Moving()), frames=(2, None)))
    for time, half, gone in (
        (0.5, False, False),
        (1, True, False),
        (2, True, True),
        (3, True, True),
        (3.1, False, True),
    ):
        opacities, old = e.posed(time).opacities, SCENE.posed(time).opacities
        want = np.where(SOME_ROWS & half, old / 2, old) * ~(~MOVING & gone)
        np.testing.assert_allclose(opacities, want, rtol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        Recolour(SOME, (0.9, 0.2, 0.1), keep_luminance=True),
        Recolour(SOME, (1.5, 0.5, 1.0), "multiply"),
        Style(SOME, "ghost"),
        Match(SOME, Moving(), 0.5),
        Grade(SOME, contrast=1.5, saturation=0.2, warmth=0.5),
    ],
)
def test_colours_may_come_little_by_little(change):
    """Linearly from the old harmonics and opacities to the new ones, which stay."""
    whole = with_operations(SCENE, change).posed(1.5)
    coming = with_operations(SCENE, replace(change, frames=(1, 3), ease="linear"))
    for time, share in ((0.0, 0), (1.0, 0), (1.5, 0.25), (2.0, 0.5), (3.0, 1), (5.0, 1)):
        shown, old, new = coming.posed(time), SCENE.posed(time), with_operations(SCENE, change).posed(time)
        np.testing.assert_allclose(shown.sh, old.sh + share * (new.sh - old.sh), atol=2e-6)
        np.testing.assert_allclose(shown.opacities, old.opacities + share * (new.opacities - old.opacities), atol=2e-6)
    assert not np.array_equal(whole.sh, SCENE.posed(1.5).sh)


def test_extract_hides_the_rest_and_copies():
    e = with_operations(SCENE, Duplicate(Moving(), (1, 0, 0)), Extract(SOME))
    assert len(e.ids) == 70
    np.testing.assert_array_equal(e.posed(0).opacities > 0, np.append(SOME_ROWS, np.zeros(20, bool)))


def test_copies():
    e = with_operations(SCENE, Duplicate(SOME, (0.5, 0, 0), count=2, name="twins"), Delete(Named("twins"), (3, None)))
    np.testing.assert_array_equal(e.ids[50:], 50 + np.arange(8))
    for time in (0.0, 2.2):
        a, b = SCENE.posed(time), e.posed(time)
        assert_posed_equal(a, rows(b, slice(50)))
        for copy in (1, 2):
            part = rows(b, slice(50 + 4 * (copy - 1), 50 + 4 * copy))
            np.testing.assert_allclose(part.means, a.means[SOME_ROWS] + [0.5 * copy, 0, 0], atol=1e-6)
            assert_posed_equal(part, rows(a, SOME_ROWS), ("quats", "scales", "opacities", "sh", "dynamic"))
    assert (e.posed(3.0).opacities[50:] == 0).all()
    assert next_id(e) == 58 and SCENE.next_id == 50


def test_ids_of_copies_follow_the_chosen_ids_and_outlive_a_switched_off_edit():
    e = with_operations(SCENE, Duplicate(Ids.of(np.array([40, 2])), (1, 0, 0), name="a"))
    e = with_operations(e, Duplicate(Named("a"), (1, 0, 0)))
    np.testing.assert_array_equal(e.ids[50:], [50, 51, 52, 53])
    np.testing.assert_allclose(e.posed(0).means[52:], SCENE.posed(0).means[[2, 40]] + [2, 0, 0], atol=1e-6)
    off = with_stack(base_of(e), of(e).enable(1, False))
    np.testing.assert_array_equal(edited(off).ids, SCENE.ids)  # the second copies copies that are not there
    assert next_id(off) == 54


@pytest.mark.parametrize(
    ("operation", "pairs"),
    [
        (Freeze(Moving(), 2), {0: 0, 2: 2, 3.5: 2, 5: 2}),
        (Freeze(Moving(), 1, 3), {0.5: 0.5, 2: 1, 3: 1, 4.5: 2.5}),
        (Retime(Moving(), 2.0), {0: 0, 1.25: 2.5, 2.5: 5, 4: 5}),
        (Retime(Moving(), 0.5, (2, 4)), {1: 1, 3: 2.5, 4: 3, 5: 4}),
        (Reverse(Moving()), {0: 5, 1.5: 3.5, 5: 0}),
        (Reverse(Moving(), (1, 3)), {0.5: 0.5, 1: 3, 2.5: 1.5, 3: 1, 4: 4}),
        (Loop(Moving(), (1, 2)), {0: 0, 2: 2, 3: 1, 4: 2, 5: 1}),
        (Loop(Moving(), (2, 2)), {1: 1, 3: 2, 5: 2}),
    ],
)
def test_retiming_shows_other_moments(operation, pairs):
    e = with_operations(SCENE, operation)
    for shown, read in pairs.items():
        assert_posed_equal(rows(e.posed(shown), MOVING), rows(SCENE.posed(read), MOVING))
        assert_posed_equal(rows(e.posed(shown), ~MOVING), rows(SCENE.posed(shown), ~MOVING))


def test_a_lagging_copy_shows_what_was_and_stands_before_the_clip():
    e = with_operations(SCENE, Duplicate(Moving(), (0, 0, 0), time_shift=2.0, count=2))
    for time, first, second in ((0, 0, 0), (3, 1, 0), (5, 3, 1)):
        for copy, read in ((0, time), (1, first), (2, second)):
            part = rows(e.posed(time), slice(30 + 20 * copy, 50 + 20 * copy))
            assert_posed_equal(part, rows(SCENE.posed(read), MOVING), ("means", "quats"))


def test_retiming_takes_earlier_edits_along():
    e = with_operations(SCENE, Transform(Moving(), (1, 0, 0), frames=(0, 4), ease="linear"), Reverse(Moving()))
    for time in (0.0, 2.0, 4.5):
        was = SCENE.posed(5 - time).means[MOVING] + [min(5 - time, 4) / 4, 0, 0]
        np.testing.assert_allclose(e.posed(time).means[MOVING], was, atol=1e-6)


def test_names_and_disabled_edits():
    stack = of(with_operations(SCENE, Name(SOME, "rex"), Recolour(Moving(), (1, 0, 0)), Delete(Named("rex"))))
    for off in ((), (2,), (1,), (1, 2)):  # a name that is switched off still means the same
        changed = stack
        for id in off:
            changed = changed.enable(id, False)
        e = edited(with_stack(SCENE, changed))
        assert (e.posed(0).opacities[SOME_ROWS] == 0).all()
        same = np.array_equal(e.posed(0).sh, SCENE.posed(0).sh)
        assert same == (2 in off)


def test_unknown_names_open_selections_and_taken_ids_are_told():
    for operation, message in (
        (Delete(Named("rex")), "edit 1 (delete): no selection before it is named 'rex'"),
        (Delete(Text(("dog",))), "edit 1 (delete): a selection by text is not settled"),
        (Delete(Point(0, 1.0, 1.0)), "by point is not settled"),
        (Transform(SOME, (1, 0, 0), unit="size"), "edit 1 (transform): its distances"),
        (Duplicate(SOME, first_id=20), "edit 1 (duplicate): ids of its copies"),
    ):
        with pytest.raises(F4xError, match=re.escape(message)):
            with_operations(SCENE, operation)
    bomb = [Duplicate(All(), (0.1, 0, 0), count=100)] * 4
    with pytest.raises(F4xError, match="are the most"):
        with_operations(SCENE, *bomb)


def test_stacks_that_need_too_many_moments_are_refused_in_time():
    slow = [Retime(Ids.of(np.arange(30, 40 + k)), 1.0 + k / 100) for k in range(1, 6)]
    lags = [Duplicate(Moving(), time_shift=0.011 * (k + 1), count=20) for k in range(2)]
    e = with_operations(SCENE, *slow, *lags)
    assert np.isfinite(e.posed(5.0).means).all()
    e = with_operations(SCENE, *[Duplicate(Moving(), time_shift=0.0011 * 31**k, count=30) for k in range(2)])
    with pytest.raises(F4xError, match="moments in one picture"):
        e.posed(5.0)
    assert len(e._posed_base) <= KEPT_MOMENTS


def test_two_hundred_edits_of_the_deepest_kind():
    e = with_operations(random_scene(dynamic=4), *[Freeze(Moving(), 3.0), Transform(Moving(), rotate=(0, 1, 0))] * 12)
    stack = of(e)
    while len(stack) < 200:
        stack = stack.append(stack.edits[len(stack) % 2].operation)
    deep = edited(with_stack(base_of(e), stack))
    assert np.isfinite(deep.posed(5.0).means).all()


def test_latents_and_queries_know_copies():
    scene = labelled_scene()
    square = select_by_text(scene, ["square"])
    e = with_operations(scene, Duplicate(Ids.of(square.chosen_ids), (0.5, 0, 0), name="twin"))
    assert len(e.latents()) == len(e.ids) == len(scene.ids) + square.chosen.sum()
    np.testing.assert_array_equal(e.latents()[len(scene.ids) :], scene.latents()[square.chosen])
    found = select_by_text(e, ["square"])
    assert found.chosen.sum() == 2 * square.chosen.sum()
    assert e.moving.sum() == 2 * scene.moving.sum()


def test_pictures_show_the_edits():
    scene = labelled_scene(features=False)
    camera = scene.cameras[0]
    drawn = render(scene, camera, 0.0, ("rgb", "motion"))
    green = render(with_operations(scene, Recolour(Moving(), (0, 1, 0))), camera, 0.0, ("rgb", "motion"))
    here = drawn["rgb"][..., 0] > 0.7
    assert here.sum() > 50 and (green["rgb"][here][:, 1] > 0.8).all() and (green["rgb"][here][:, 0] < 0.2).all()
    np.testing.assert_array_equal(drawn["motion"][here], green["motion"][here])
    slide = with_operations(scene, Transform(Not(Moving()), (0.4, 0, 0), frames=(0, 4), ease="linear"))
    moved = render(slide, camera, 1.0, ("motion",))["motion"]
    assert np.median(moved[:3, :, 0]) == pytest.approx(0.1 * 60 / 1.2, rel=0.02)  # the wall slides now


def test_open_scene_says_how_to_open_a_broken_one(tmp_path):
    path = tmp_path / "a.f4x"
    write_scene(random_scene(edits=({"op": "explode", "id": 1},)), path)
    with pytest.raises(F4xError, match="--without-edits opens it without") as caught:
        open_scene(path)
    assert str(caught.value).startswith(str(path))
    assert open_scene(path, edits=False).edits == ()
    write_scene(base_of(with_operations(SCENE, Delete(SOME))), path)
    assert (open_scene(path).posed(0).opacities[SOME_ROWS] == 0).all()
    assert (open_scene(path, edits=False).posed(0).opacities > 0).all()


@pytest.mark.parametrize(
    ("before", "gone"),
    [
        ([], False),
        ([Opacity(SOME, 0.0)], False),
        ([Opacity(SOME, 0.0, frames=(1, 2))], False),
        ([Opacity(SOME, 0.4)], False),
        ([Opacity(SOME, 0.0, (0.0, 4.0), "linear")], False),
        ([Delete(SOME)], True),
    ],
)
def test_what_is_shown_again_is_as_opaque_as_fitted(before, gone):
    shown = with_operations(SCENE, *before, Opacity(SOME, SHOWN))
    for time in (0.0, 1.5, 3.0):
        fitted = SCENE.posed(time).opacities.copy()
        fitted[SOME_ROWS & gone] = 0
        found = np.zeros(len(fitted))
        posed = shown.posed(time)
        found[np.searchsorted(SCENE.ids, posed.ids)] = posed.opacities
        np.testing.assert_array_equal(found, fitted)


def test_what_is_shown_again_little_by_little_comes_evenly():
    hidden = [Opacity(SOME, 0.0), Opacity(SOME, SHOWN, (0.0, 4.0), "linear")]
    fitted, found = SCENE.posed(1.0).opacities, with_operations(SCENE, *hidden).posed(1.0).opacities
    np.testing.assert_allclose(found[SOME_ROWS], 0.25 * fitted[SOME_ROWS], rtol=1e-5)
    np.testing.assert_array_equal(found[~SOME_ROWS], fitted[~SOME_ROWS])
