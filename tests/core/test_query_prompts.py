"""Words, points, boxes and masks on a scene whose meaning is known, and the pictures of the answers."""

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, LABELS, VECTORS, WIDTH, labelled_scene, square_mask

from f4x_core.errors import F4xError
from f4x_core.geometry.trajectory import View, orbit, original
from f4x_core.query import prompts
from f4x_core.query.blend_weights import blend_weight_sums, lift_masks
from f4x_core.query.decoder_prompt import check_frame, check_prompt
from f4x_core.query.labels import ask_for
from f4x_core.query.matte import mask_video
from f4x_core.query.pixels import coverage_image, head_map, heat_map, text_score_map
from f4x_core.query.prompts import (
    SelectOptions,
    select_by_box,
    select_by_mask,
    select_by_points,
    select_by_prompts,
    select_by_text,
)
from f4x_core.query.score import overlap
from f4x_core.scene.view import render


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture(scope="module")
def plain():
    return labelled_scene(features=False)


def is_square(scene):
    return np.arange(len(scene.static) + len(scene.dynamic)) >= len(scene.static)


def test_light_is_what_each_gaussian_adds_to_the_picture(plain):
    """Light into a mask, by drawing each Gaussian's own weight: the picture of a one-hot channel."""
    mask = square_mask(2).astype(np.float32)
    light = blend_weight_sums(plain, 2.0, 2, np.stack([mask, np.ones_like(mask)], -1))
    some = np.r_[400:404, len(plain.static) : len(plain.static) + 4]
    values = np.zeros((len(light), len(some)), np.float32)
    values[some, np.arange(len(some))] = 1
    drawn = render(plain, plain.cameras[2], 2.0, ("alpha",), values={"own": values})
    np.testing.assert_allclose(light[some, 0], (drawn["own"] * mask[..., None]).sum((0, 1)), atol=1e-3)
    assert light[:, 1].sum() == pytest.approx(drawn["alpha"].sum(), rel=1e-4)


def test_lifted_masks_tell_square_from_wall(plain):
    share, light = lift_masks(plain, {t: square_mask(t) for t in range(FRAMES)})
    seen = light > 0.5
    assert np.median(share[is_square(plain) & seen]) > 0.9
    assert np.median(share[~is_square(plain) & seen]) < 0.01


def test_a_word_selects_by_its_latent(scene):
    found = select_by_text(scene, ["square"])
    np.testing.assert_array_equal(found.chosen, is_square(scene))
    np.testing.assert_array_equal(select_by_text(scene, ["Wall"], ["square"]).chosen, ~is_square(scene))
    assert select_by_text(scene, ["square", "wall"]).chosen.all()
    assert not select_by_text(scene, ["sky"], ["square", "wall"]).chosen.any()
    np.testing.assert_array_equal(found.ids, scene.posed(0.0).ids)


def test_default_background_words_are_left_out_when_asked_for(scene):
    assert set(ask_for(scene, ["square"]).labels) == set(LABELS)
    assert ask_for(scene, ["sky"]).labels.count("sky") == 1


def test_a_word_that_only_the_encoder_knows(scene):
    asked = []

    def encode(encoder, labels):
        asked.append((encoder, labels))
        return VECTORS[[0]]

    assert select_by_text(scene, ["red thing"], encode=encode).chosen.sum() == len(scene.dynamic)
    assert asked == [("words", ["red thing"])]


@pytest.mark.parametrize("word", ["Square", "the square", "a  square", "Squares", "any squares"])
def test_words_of_the_vocabulary_need_no_encoder(scene, word):
    found = select_by_text(scene, [word], ["the walls"])  # without an encoder others are refused
    np.testing.assert_array_equal(found.scores, select_by_text(scene, ["square"], ["wall"]).scores)


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        (["sqare"], "lacks 'sqare'; near it is square"),
        (["zebra"], "lacks 'zebra'; add it with"),
        ([""], "no label"),
        ([], "no label"),
    ],
)
def test_words_that_nobody_knows(scene, labels, words):
    with pytest.raises(F4xError, match=words):
        select_by_text(scene, labels)


def test_a_scene_without_field_has_no_words(plain):
    with pytest.raises(F4xError, match=r"knows no words.*f4x distill"):
        select_by_text(plain, ["square"])


def test_text_pictures_are_probabilities_from_any_view(scene):
    query = ask_for(scene, ["square"], ["wall"])
    for camera, time in (*original(scene.cameras)[::3], *orbit(scene.cameras, degrees=4, count=3)):
        picture = text_score_map(scene, query, camera, time)
        mask = coverage_image(scene, select_by_text(scene, ["square"]), camera, time) > 0.5
        assert overlap(picture[..., 0] > 0.5, mask) > 0.9
        np.testing.assert_allclose(picture[mask].sum(-1), 1, atol=1e-5)


@pytest.mark.parametrize("kind", ["scene", "plain"])
def test_a_mask_on_one_frame_follows_the_square(request, kind):
    scene = request.getfixturevalue(kind)
    found = select_by_mask(scene, square_mask(0), 0)
    for (_, time), shown in zip(
        original(scene.cameras), mask_video(scene, found, original(scene.cameras)), strict=True
    ):
        assert overlap(shown.matte > 0.5, square_mask(time)) > 0.85, time


def test_points_and_boxes_find_the_square(scene):
    rows, columns = np.nonzero(square_mask(3))
    middle = (columns.mean() + 0.5, rows.mean() + 0.5)
    box = (columns.min() - 2, rows.min() - 2, columns.max() + 3, rows.max() + 3)
    for found in (select_by_points(scene, [middle], 3), select_by_box(scene, box, 3)):
        share = coverage_image(scene, found, scene.cameras[0], 0.0)
        assert overlap(share > 0.5, square_mask(0)) > 0.7


def test_marks_that_leave_nothing_are_told(scene, monkeypatch):
    monkeypatch.setattr(prompts, "point_out", lambda *given, **config: None)
    with pytest.raises(F4xError, match="Nothing is left"):
        select_by_box(scene, (1, 1, 9, 9), 0)


def test_several_frames_add_up(scene):
    masks = {t: {"mask": square_mask(t)} for t in (0, 5)}
    found = select_by_prompts(scene, masks, SelectOptions(span=(1, 4)))
    assert (found.chosen == is_square(scene)).mean() > 0.99
    camera = scene.cameras[0]
    assert not coverage_image(scene, found, camera, 0.0).any() and coverage_image(scene, found, camera, 1.0).any()


def test_masks_of_another_size_are_scaled(scene):
    big = square_mask(0).repeat(2, 0).repeat(2, 1)
    np.testing.assert_array_equal(select_by_mask(scene, big, 0).scores, select_by_mask(scene, square_mask(0), 0).scores)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: select_by_points(s, [(-1, 3)], 0), "outside the picture"),
        (lambda s: select_by_points(s, [(WIDTH + 1, 3)], 0), "outside the picture"),
        (lambda s: select_by_points(s, [(3, 3)], FRAMES), f"no frame {FRAMES}"),
        (lambda s: select_by_points(s, [], 0), "no place"),
        (lambda s: select_by_box(s, (5, 5, 5, 9), 0), "box"),
        (lambda s: select_by_mask(s, np.zeros((HEIGHT, WIDTH)), 0), "empty"),
        (lambda s: select_by_mask(s, np.ones((4, 4, 3)), 0), "shape"),
        (lambda s: select_by_mask(s, np.ones((HEIGHT, HEIGHT)), 0), "clip's pictures"),
        (lambda s: select_by_mask(s, square_mask(0), -1), "no frame -1"),
        (lambda s: select_by_mask(s, square_mask(0), 0, SelectOptions(span=(0, 99))), "within the clip"),
        (lambda s: select_by_prompts(s, {}), "Nothing is prompted"),
    ],
)
def test_prompts_that_mean_nothing(scene, call, words):
    with pytest.raises(F4xError, match=words):
        call(scene)


def test_a_head_map_is_on_the_heads_grid(scene):
    features = head_map(scene, "visual", scene.cameras[0], 0.0)
    assert features.shape == (20, 32, 8)
    assert features[0, 0].argmax() == 1  # the wall is in the corner


def test_heat_maps(scene):
    picture = np.full((4, 6, 3), 0.5)
    score = np.zeros((4, 6))
    score[1, 2] = 1
    heat = heat_map(picture, score)
    assert heat.shape == (4, 6, 3) and heat.dtype == np.uint8
    assert heat[1, 2, 0] > heat[1, 2, 2] and heat[0, 0, 2] > heat[0, 0, 0] // 2


def test_selections_hold_from_a_standing_camera_too(scene):
    found = select_by_text(scene, ["square"])
    views = [View(scene.cameras.at(0.0), float(time)) for time in scene.cameras.times]
    centres = [np.nonzero(shown.matte > 0.5)[1].mean() for shown in mask_video(scene, found, views)]
    assert np.diff(centres).min() > 1


@pytest.mark.parametrize(
    ("prompt", "sentence"),
    [
        ({"t": 0}, "The prompt is empty"),
        ({"t": 9, "points": [[1, 1]]}, "There is no frame 9: the clip has frames 0 to 4"),
        ({"t": -1, "points": [[1, 1]]}, "There is no frame -1"),
        ({"t": 0, "points": [[70, 1]]}, r"Point \(70, 1\) lies outside the picture of 64 x 48"),
        ({"t": 0, "points": [[64, 1]]}, "lies outside"),
        ({"t": 0, "points": [[np.nan, 1]]}, "lies outside"),
        ({"t": 0, "points": [[1, 1]], "labels": [1, 0]}, "1 points and 2 labels"),
        ({"t": 0, "points": [[1, 1]], "labels": [0]}, "at least one positive point"),
        ({"t": 0, "points": []}, "at least one positive point"),
        ({"t": 0, "box": [9, 1, 3, 8]}, "left < right"),
        ({"t": 0, "box": [1, 2, 3]}, "left < right"),
        ({"t": 0, "box": [65, 1, 80, 8]}, "lies outside"),
        ({"t": 0, "mask": np.zeros((48, 64))}, "mask is empty"),
        ({"t": 0, "mask": np.ones((4, 4))}, "48 rows x 64 columns"),
        ({"t": 0, "mask": np.ones((48, 64)), "points": [[1, 1]]}, "complete prompt"),
    ],
)
def test_prompts_that_mean_nothing_are_refused(prompt, sentence):
    with pytest.raises(F4xError, match=sentence):
        check_frame(prompt.pop("t"), 5)
        check_prompt((48, 64), **prompt)
