"""Colors over time: kept in the scene, shown by it, carried through edits, and found where a clip asks for them."""

from dataclasses import replace

import numpy as np
import pytest
from random_scene import assert_same, random_scene

from f4x_core.clip import Clip
from f4x_core.edit.apply import base_of, edited, with_operations
from f4x_core.edit.bake import bake
from f4x_core.edit.operations import Delete, Duplicate, Freeze, Opacity, Recolour, Transform
from f4x_core.edit.selects import All, Ids, Moving, Not
from f4x_core.errors import F4xError
from f4x_core.fit.tints import TintConfig, tinted_scene
from f4x_core.geometry.spherical_harmonics import C0, rgb_from_dc
from f4x_core.parallel import side_by_side
from f4x_core.raster.blend_weights import BlendWeights
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.tints import PARTS, TIMES, tinted, tints_in, with_tints, without_tints
from f4x_core.scene.view import render

KNOTS = np.array([0.0, 1.0, 3.0, 5.0])
M, S = Moving(), Not(Moving())


def tinted_random(seed=3):
    """A random scene whose Gaussians all refer to frame 0, with random tints at `KNOTS`."""
    scene = random_scene(seed, degree=1)
    scene = replace(scene, dynamic=replace(scene.dynamic, reference=np.zeros_like(scene.dynamic.reference)))
    values = np.random.default_rng(seed).integers(-40, 41, (len(scene.ids), len(KNOTS), 3)).astype(np.int8)
    return with_tints(scene, KNOTS, values)


SCENE = tinted_random()


def added(scene, time):
    """(N,3) what `posed` adds to the display color."""
    return (scene.posed(time).sh[:, 0] - without_tints(scene).posed(time).sh[:, 0]) * C0


@pytest.mark.parametrize(
    ("time", "weights"),
    [
        (-1, [1, 0, 0, 0]),
        (0, [1, 0, 0, 0]),
        (0.25, [0.75, 0.25, 0, 0]),
        (2, [0, 0.5, 0.5, 0]),
        (5, [0, 0, 0, 1]),
        (9, [0, 0, 0, 1]),
    ],
)
def test_tints_are_linear_between_their_times_and_stay_outside(time, weights):
    values = np.concatenate([SCENE.extra[name] for name in PARTS]).astype(float)
    np.testing.assert_allclose(added(SCENE, time), np.einsum("nkc,k->nc", values, weights) / 255, atol=1e-6)


def test_one_time_is_for_all():
    scene = with_tints(without_tints(SCENE), [2.0], np.full((len(SCENE.ids), 1, 3), 51, np.int8))
    np.testing.assert_allclose(added(scene, 4.0), 0.2, atol=1e-6)


def test_a_scene_without_tints_keeps_its_bits():
    plain = without_tints(SCENE)
    assert plain.tints is None and not {TIMES, *PARTS} & plain.extra.keys()
    assert plain.posed(1.5).sh is plain.posed(2.5).sh
    assert without_tints(plain) is plain


def test_the_file_holds_them(tmp_path):
    write_scene(SCENE, tmp_path / "s.f4x")
    again = read_scene(tmp_path / "s.f4x")
    assert_same(again, SCENE)
    np.testing.assert_array_equal(again.posed(2.2).sh, SCENE.posed(2.2).sh)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        (TIMES, np.array([0.0, 1.0, 1.0, 2.0]), "increase"),
        (TIMES, np.array([0.0, np.nan, 2.0, 3.0]), "increase"),
        (TIMES, np.zeros(0), "increase"),
        (TIMES, KNOTS[:3], "int8"),
        (PARTS[0], np.zeros((30, 4, 3), np.float32), "int8"),
        (PARTS[1], None, "int8"),
    ],
)
def test_tints_that_do_not_belong_to_the_scene_are_refused(name, value, told):
    extra = {key: array for key, array in {**SCENE.extra, name: value}.items() if array is not None}
    with pytest.raises(F4xError, match=told):
        replace(SCENE, extra=extra)


def test_a_still_scene_needs_no_dynamic_tints():
    scene = with_tints(random_scene(1, dynamic=0), KNOTS, np.ones((30, 4, 3), np.int8))
    assert PARTS[1] not in scene.extra
    np.testing.assert_allclose(added(scene, 2.0), 1 / 255, atol=1e-6)
    assert tints_in({}, (30, 0)) is None


EDITS = {
    "nothing": [],
    "moved": [Transform(All(), (1, 0, 0), (0, 40, 0), 2.0)],
    "copies": [Duplicate(All(), (1, 0, 0), count=2), Delete(Ids.of(np.array([2, 33])))],
    "fainter": [Opacity(S, 0.5)],
    "red": [Recolour(M, (1, 0, 0), keep_luminance=True)],
    "standing moves": [Transform(S, (0.2, 0, 0), (0, 90, 0), frames=(1, 4))],
    "frozen": [Freeze(M, 2.5)],
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_baked_edits_show_the_same_colors(name):
    scene = base_of(with_operations(SCENE, *EDITS[name]))
    shown, baked = edited(scene), bake(scene)
    for time in KNOTS:
        a, b = shown.posed(float(time)), edited(baked).posed(float(time))
        place = {id: row for row, id in enumerate(a.ids.tolist())}
        row = np.array([place[id] for id in b.ids.tolist()])
        np.testing.assert_allclose(b.sh[:, 0], a.sh[row, 0], atol=0.51 / 255 / C0)


def test_edits_leave_the_tints_of_others_and_pass_on_those_of_what_they_recolor():
    whole = base_of(with_operations(SCENE, Recolour(M, (1, 0, 0), "multiply", 1.0)))
    before, after = SCENE.posed(1.0), edited(whole).posed(1.0)
    still = ~before.dynamic
    np.testing.assert_array_equal(after.sh[still], before.sh[still])
    steady = edited(without_tints(whole)).posed(1.0)
    change = (after.sh[:, 0] - steady.sh[:, 0]) * C0
    black = np.abs(rgb_from_dc(steady.sh[~still, 0])[:, 1:]) < 1e-6  # nothing of green and blue is left to flicker
    assert black.any()
    assert not change[~still, 1:][black].any()


def test_a_frozen_thing_has_the_colors_of_the_moment_it_shows():
    frozen = edited(base_of(with_operations(SCENE, Freeze(M, 3.0))))
    np.testing.assert_allclose(frozen.posed(5.0).sh[frozen.moving], SCENE.posed(3.0).sh[frozen.moving], atol=1e-6)


@pytest.mark.parametrize("backend", ["native", "plain", "torch"])
def test_pictures_and_sums_are_each_others_transpose(backend):
    posed, rng = SCENE.posed(1.0), np.random.default_rng(0)
    weights = BlendWeights(posed, SCENE.cameras[1], 3, backend=backend)
    colors, layers = rng.normal(size=(len(posed), 3)), rng.normal(size=(SCENE.cameras.height, SCENE.cameras.width, 3))
    ahead = (weights.picture(colors) * layers).sum()
    back = (weights.sums(layers) * colors).sum()
    assert ahead == pytest.approx(back, rel=1e-4)


def clip_of(scene, change):
    """A clip of what `scene` shows, with `change(picture, t)` made to each frame."""
    cameras = scene.cameras
    frames = [change(render(scene, cameras[t], float(t), ("rgb",))["rgb"].clip(0, 1), t) for t in range(len(cameras))]
    frames = (255 * np.stack(frames)).round().clip(0, 255).astype(np.uint8)
    held = np.isin(np.arange(len(frames)), scene.held_out)
    return Clip("made", frames, np.arange(float(len(frames))), 24.0, held, "made.mp4")


def dimmed(picture, t):
    """A shadow that comes over the left half, steadily."""
    picture = picture.copy()
    picture[:, : picture.shape[1] // 2] *= 1 - 0.1 * t
    return picture


PLAIN = random_scene(5, static=400, dynamic=30, held_out=())


def test_what_changes_steadily_is_found_and_what_stays_is_not():
    config = TintConfig()
    found = tinted_scene(PLAIN, clip_of(PLAIN, dimmed), config)
    assert found.tints is not None and len(found.tints.times) == len(PLAIN.cameras)
    assert found.needs[-1]["chosen"] == f"of {len(PLAIN.cameras)} moments: shadows, ripples, blur"
    clip = clip_of(PLAIN, dimmed)

    def error(scene, t):
        picture = render(scene, scene.cameras[t], float(t), ("rgb",))["rgb"].clip(0, 1)
        return float(np.square(picture - clip.frames[t] / 255).mean())

    assert all(error(found, t) < 0.2 * error(PLAIN, t) for t in range(2, 6))
    same = tinted_scene(PLAIN, clip_of(PLAIN, lambda picture, t: picture), config)
    assert same.tints is None and same.needs[-1]["chosen"] == "none"


def test_flicker_that_no_neighbour_shares_is_no_color_over_time():
    clip = clip_of(PLAIN, lambda picture, t: picture * (1 - 0.2 * (t % 2)))
    assert tinted_scene(PLAIN, clip, TintConfig()).tints is None


def test_held_out_frames_are_not_looked_at():
    scene = replace(PLAIN, held_out=(3,))
    spoilt = clip_of(scene, lambda picture, t: dimmed(picture, t) if t != 3 else 0 * picture)
    whole = clip_of(scene, dimmed)
    ones = [tinted_scene(scene, clip, TintConfig()) for clip in (spoilt, whole)]
    assert 3.0 not in ones[0].tints.times
    assert_same(*ones)


def test_hidden_pixels_do_not_count():
    clip = clip_of(PLAIN, dimmed)
    hidden = np.zeros(clip.frames.shape[:3], bool)
    hidden[:, :10] = True
    other = clip.frames.copy()
    other[:, :10] = 255 - other[:, :10]
    a, b = (tinted_scene(PLAIN, replace(clip, frames=f, hidden=hidden), TintConfig()) for f in (clip.frames, other))
    assert_same(a, b)


def test_the_number_of_threads_and_of_parts_changes_nothing():
    clip = clip_of(PLAIN, dimmed)
    one = tinted_scene(PLAIN, clip, TintConfig())
    with side_by_side(3):
        assert_same(tinted_scene(PLAIN, clip, TintConfig()), one)


def test_there_are_no_more_moments_than_there_is_room_for():
    room = 3 * len(PLAIN.ids) * 3.5 / 1e6
    found = tinted_scene(PLAIN, clip_of(PLAIN, dimmed), TintConfig(megabytes=room, min_gain=-99.0))
    assert len(found.tints.times) == 3


def test_the_room_grows_with_the_frames_beyond_a_hundred():
    assert TintConfig(megabytes=48.0).bytes_for(20) == TintConfig(megabytes=48.0).bytes_for(100) == 48e6
    assert TintConfig(megabytes=48.0).bytes_for(300) == pytest.approx(144e6)


def test_none_are_tried_where_none_are_wanted():
    assert tinted_scene(PLAIN, clip_of(PLAIN, dimmed), TintConfig(enabled=False)) is PLAIN


def test_tinted_changes_the_color_alone():
    sh = SCENE.static.sh
    changed = tinted(sh, np.full((len(sh), 3), 0.1, np.float32))
    np.testing.assert_array_equal(changed[:, 1:], sh[:, 1:])
    np.testing.assert_allclose(rgb_from_dc(changed[:, 0]), rgb_from_dc(sh[:, 0]) + 0.1, atol=1e-6)


def test_what_moves_leaves_nothing_on_what_stands_behind_it():
    """A bright thing that no dynamic Gaussian shows, inside the mask: the background behind it keeps its color."""

    def with_a_thing(picture, t):
        picture = dimmed(picture, t)
        picture[12:24, 10 + t : 22 + t] = 1.0
        return picture

    clip = clip_of(PLAIN, with_a_thing)
    masks = {t: np.zeros(clip.frames.shape[1:3], bool) for t in range(len(clip))}
    for t, mask in masks.items():
        mask[12:24, 10 + t : 22 + t] = True
    plate = clip_of(PLAIN, dimmed).frames[3, 13:23, 14:24] / 255
    errors = []
    for known in (masks, None):
        found = tinted_scene(PLAIN, clip, TintConfig(min_gain=-99.0), known).background
        shown = render(found, found.cameras[3], 3.0, ("rgb",))["rgb"].clip(0, 1)[13:23, 14:24]
        errors.append(float(np.square(shown - plate).mean()))
    assert errors[0] < 0.1 * errors[1]
