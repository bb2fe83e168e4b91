"""Contrast, warmth, blur, glow, places of two, parts by place and eased speed: what each does to numbers."""

from dataclasses import replace

import numpy as np
import pytest
from effect_scenes import effect_scene
from random_scene import random_scene

from f4x_core.edit import colours, plan
from f4x_core.edit.apply import edited, with_operations
from f4x_core.edit.bake import bake
from f4x_core.edit.language import parse
from f4x_core.edit.operation.blur import thinning
from f4x_core.edit.operations import Blur, Duplicate, Glow, Grade, Recolour, Retime, Swap, Transform
from f4x_core.edit.request import Request
from f4x_core.edit.resolve import EditorState, resolve
from f4x_core.edit.selects import All, Ids, Part
from f4x_core.edit.stack import of
from f4x_core.errors import F4xError
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import Camera
from f4x_core.query.connected_objects import part_of
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.view import render

SCENE = random_scene()
FEW, OTHERS = Ids.of(np.arange(5)), Ids.of(np.arange(5, 12))


def test_contrast_spreads_lights_about_the_mean_and_keeps_tints():
    lab = np.array([[0.4, 0.02, 0.01], [0.6, -0.01, 0.02]])
    graded = colours.lab_from_rgb(colours.graded(colours.rgb_from_lab(lab), 1.5, 1.0, 0.0, 0.5))
    np.testing.assert_allclose(graded, [[0.35, 0.02, 0.01], [0.65, -0.01, 0.02]], atol=1e-6)
    gray = colours.lab_from_rgb(colours.graded(colours.rgb_from_lab(lab), 1.0, 0.0, 0.0, 0.5))
    np.testing.assert_allclose(gray[:, 1:], 0, atol=1e-6)
    warm = colours.lab_from_rgb(colours.graded(colours.rgb_from_lab(lab), 1.0, 1.0, 0.5, 0.5))
    np.testing.assert_allclose(warm[:, 2] - lab[:, 2], 0.5 * colours.WARM[1] * lab[:, 0], atol=1e-6)
    turned = colours.lab_from_rgb(colours.graded(colours.rgb_from_lab(lab), 1.0, 1.0, 0.0, 0.5, hue=90.0))
    np.testing.assert_allclose(turned[:, 1:], np.stack([-lab[:, 2], lab[:, 1]], 1), atol=1e-6)


@pytest.mark.parametrize(
    ("sentence", "factor"),
    [
        ("exposure +0.5", 2**0.5),
        ("exposure +1/2 stop", 2**0.5),
        ("exposure -1", 0.5),
        ("lower the exposure of the dog by 1/2", 2**-0.5),
        ("raise the exposure by 0.5 from frame 3", 2**0.5),
        ("set the exposure to +2", 4.0),
        ("exposure +50%", 1.5),
        ("exposure 80", 0.8),
        ("double the exposure", 2.0),
        ("raise the exposure of the dog", 2.0),
        ("the dog half a stop darker", 2**-0.5),
        ("bring the dog up 1.5 stops", 2**1.5),
        ("gain 1.2 on the dog", 1.2),
        ("the dog is overexposed", 0.5),
    ],
)
def test_bare_numbers_of_an_exposure_are_stops(sentence, factor):
    (operation,) = parse(Request(sentence, ("dog",), fps=24.0, frames=48))
    assert operation.mode == "light" and operation.rgb == pytest.approx((factor,) * 3, abs=1e-3)


@pytest.mark.parametrize(
    ("sentence", "times"), [("exposure +1", 2.0), ("exposure -1", 0.5), ("up by half a stop", 2**0.5)]
)
def test_a_stop_up_doubles_the_linear_light_of_a_picture(sentence, times):
    scene = effect_scene("street")[0]
    edited_scene = plan.preview(scene, plan.propose(scene, sentence).chosen)
    before, after = (render(one, one.cameras[0], 0.0, ("rgb", "alpha")) for one in (scene, edited_scene))
    mid = (before["alpha"] > 0.99)[..., None] & (before["rgb"] > 0.2) & (before["rgb"] < 0.6)
    assert mid.sum() > 1000
    np.testing.assert_allclose(
        linear_from_srgb(after["rgb"])[mid], times * linear_from_srgb(before["rgb"])[mid], rtol=3e-3
    )


def test_a_stop_is_seen_from_every_side_and_taken_back_by_a_stop_down():
    scene = random_scene(degree=1)
    up = with_operations(scene, Recolour(All(), (2, 2, 2), "light"))
    old, new = (one.colors(one.posed(1.0), one.cameras[2]) for one in (scene, up))
    shown = (old > 0.3) & (spherical_harmonics.rgb_from_dc(scene.posed(1.0).sh[:, 0]) > 0.3)
    assert shown.sum() > 20
    np.testing.assert_allclose(linear_from_srgb(new)[shown], 2 * linear_from_srgb(old)[shown], rtol=0.02)
    back = with_operations(up, Recolour(All(), (0.5, 0.5, 0.5), "light")).posed(1.0)
    np.testing.assert_allclose(back.sh, scene.posed(1.0).sh, atol=1e-5)  # nothing was clipped on the way


def test_an_exposure_of_an_older_file_looks_as_it_did():
    saved = {
        "op": "recolour",
        "select": {"by": "all"},
        "rgb": [2.0, 2.0, 2.0],
        "mode": "multiply",
        "id": 1,
        "said": "exposure +1",
    }
    after = edited(replace(SCENE, edits=(saved,)))
    np.testing.assert_allclose(after.posed(1.0).sh[:, 1:], 2 * SCENE.posed(1.0).sh[:, 1:], rtol=1e-6)
    assert "twice as bright" in after.steps[0].edit.operation.described()


def test_an_exposure_by_nothing_is_refused():
    with pytest.raises(F4xError, match=r"say for example 'exposure \+0.5'"):
        parse(Request("exposure 0", fps=24.0, frames=48))


def test_grading_by_nothing_changes_no_bit():
    np.testing.assert_array_equal(with_operations(SCENE, Grade(All())).posed(1.0).sh, SCENE.posed(1.0).sh)


def test_a_blur_widens_and_thins():
    before, after = SCENE.posed(1.0), with_operations(SCENE, Blur(FEW, 0.3)).posed(1.0)
    few = np.isin(SCENE.ids, FEW.array)
    np.testing.assert_allclose(after.scales[few], np.hypot(before.scales[few], 0.3), rtol=1e-5)
    np.testing.assert_array_equal(after.scales[~few], before.scales[~few])
    light = before.opacities[few] * np.prod(np.sort(before.scales[few], 1)[:, 1:], 1)
    np.testing.assert_allclose(
        after.opacities[few] * np.prod(np.sort(after.scales[few], 1)[:, 1:], 1), light, rtol=1e-4
    )
    assert thinning(before.scales, 0.0) == pytest.approx(1)


def light_of(posed, few):
    """What every one of the Gaussians `few` stops, seen along its thinnest axis."""
    return posed.opacities[few] * np.prod(np.sort(posed.scales[few], 1)[:, 1:], 1)


@pytest.mark.parametrize("copied", [False, True], ids=["itself", "copied"])
def test_a_blur_thins_by_the_sizes_that_the_edits_before_it_left(copied):
    sizes = (Transform(FEW, scale=0.5), *([Duplicate(All(), (1.0, 0.0, 0.0))] if copied else []))
    before, after = (with_operations(SCENE, *sizes, *more).posed(1.0) for more in ((), (Blur(All(), 0.3),)))
    every = np.arange(len(before.ids))
    np.testing.assert_allclose(light_of(after, every), light_of(before, every), rtol=1e-4)
    baked = edited(bake(with_operations(SCENE, *sizes, Blur(All(), 0.3)))).posed(1.0)
    in_order, expected = (posed.opacities[np.argsort(posed.ids)] for posed in (baked, after))
    np.testing.assert_allclose(in_order, expected, rtol=1e-5)


def test_a_glow_is_one_edit_with_a_halo_that_goes_when_it_ends():
    glowing = with_operations(SCENE, Glow(FEW, strength=0.5, frames=(1.0, 2.0)))
    assert len(of(glowing)) == 1 and len(glowing.ids) == len(SCENE.ids) + 5
    halo = slice(len(SCENE.ids), None)
    assert (glowing.posed(1.5).opacities[halo] > 0).all()
    assert (glowing.posed(0.5).opacities[halo] == 0).all() and (glowing.posed(2.5).opacities[halo] == 0).all()


def test_two_things_change_places_and_the_edit_bakes_exactly():
    swap = resolve(SCENE, Swap(FEW, OTHERS), EditorState(frame=1.0))
    moved, before = with_operations(SCENE, swap), SCENE.posed(1.0).means
    shift = np.array(swap.shift)
    np.testing.assert_allclose(moved.posed(1.0).means[:5], before[:5] + shift, atol=1e-5)
    np.testing.assert_allclose(moved.posed(1.0).means[5:12], before[5:12] - shift, atol=1e-5)
    np.testing.assert_array_equal(moved.posed(1.0).means[12:], before[12:])
    baked = bake(moved)
    assert not baked.edits
    np.testing.assert_allclose(baked.posed(2.0).means, moved.posed(2.0).means, atol=1e-4)
    with pytest.raises(F4xError, match="share Gaussians"):
        resolve(SCENE, Swap(All(), FEW), EditorState())
    with pytest.raises(F4xError, match="plan the edit"):
        with_operations(SCENE, Swap(FEW, OTHERS))


def test_what_cannot_be_folded_stays_in_the_stack():
    baked = bake(with_operations(SCENE, Transform(FEW, (1.0, 0.0, 0.0)), Blur(FEW, 0.1)))
    assert [edit.operation.TAG for edit in of(baked).edits] == ["blur"]


@pytest.mark.parametrize("ease", ["linear", "smooth"])
def test_an_eased_speed_is_the_old_one_at_first_and_the_new_one_at_last(ease):
    shown = Retime(All(), 0.5, (10.0, 20.0), ease).time_map((0.0, 59.0))
    times = np.linspace(0, 40, 401)
    speed = np.gradient([shown(t) for t in times], times)
    np.testing.assert_allclose(speed[(times < 9.9)], 1, atol=1e-6)
    np.testing.assert_allclose(speed[(times > 20.1)], 0.5, atol=1e-6)
    assert speed[np.abs(times - 15).argmin()] == pytest.approx(0.75, abs=1e-3)
    assert shown(20.0) == pytest.approx(10 + 10 * 0.75)


@pytest.mark.parametrize("speed", [0.1, 0.5, 0.9, 2.0, 5.0])
def test_a_speed_with_soft_ends_shows_as_much_as_at_once_and_is_over_at_the_last_frame(speed):
    soft, hard = (Retime(All(), speed, (10.0, 30.0), ease).time_map((0.0, 199.0)) for ease in ("soft", None))
    times = np.linspace(0, 40, 4001)
    speeds = np.gradient([soft(t) for t in times], times)
    assert soft(30.0) == pytest.approx(hard(30.0))
    assert soft(20.0) == pytest.approx(hard(20.0))  # what comes and what goes are alike
    assert soft(37.0) - soft(30.0) == pytest.approx(7.0)
    assert speeds.min() > 0  # it never stands still or runs back
    assert np.abs(np.diff(speeds)).max() < 0.05 * abs(speed - 1) + 0.01  # and never jumps


def test_the_upper_half_is_what_lies_above_the_middle_of_the_picture_of_it():
    camera = Camera(np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]]), np.eye(4), 64, 40)
    points = np.stack([np.zeros(101), np.linspace(-1, 1, 101), np.full(101, 3.0)], 1)
    upper = part_of(points, "top", 0.5, camera)
    assert upper[points[:, 1] < -0.01].all() and not upper[points[:, 1] > 0.01].any()  # y points down
    part = resolve(SCENE, Grade(Part(FEW, "left", 0.5), contrast=2), EditorState()).select
    assert 0 < len(part.array) < 5 and set(part.array) < set(FEW.array)
