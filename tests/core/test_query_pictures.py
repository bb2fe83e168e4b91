"""Blend weights over views, pictures of scores and coverage, and leakage, where each number is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import VECTORS, labelled_scene

from f4x_core.query import blend_weights, leakage, matte, pixels
from f4x_core.query.labels import ask_for
from f4x_core.query.score import text_scores
from f4x_core.query.selection import Selection
from f4x_core.scene.clouds import COVERED
from f4x_core.scene.view import render
from f4x_core.scene.visualise import SPECTRUM


@pytest.fixture(scope="module")
def scene():
    """The labelled scene, whose latents are a little random."""
    scene = labelled_scene()
    random = np.random.default_rng(0)
    low, step = np.full(8, -0.1), np.full(8, 0.01)
    static, nodes = (random.integers(0, 120, rows.shape) for rows in (scene.features.static, scene.features.nodes))
    parts = {"static": static.astype(np.uint8), "nodes": nodes.astype(np.uint8)}
    return replace(scene, features=replace(scene.features, **parts, low=low.astype("f4"), step=step.astype("f4")))


@pytest.fixture(scope="module")
def wide(scene):
    """Its first camera with a wider angle, which sees past the wall."""
    camera = scene.cameras[0]
    return replace(camera, intrinsics=camera.intrinsics * [[0.4], [0.4], [1]] + [[0, 0, 19.2], [0, 0, 12], [0, 0, 0]])


def chosen_by(scene, scores, threshold=0.5):
    return Selection(scene.ids, scores, np.zeros(len(scores), bool), threshold)


def test_blend_weights_are_those_of_the_camera_at_a_time_or_of_a_number(monkeypatch):
    asked = []
    monkeypatch.setattr(blend_weights.blend_weights, "blend_weight_sums", lambda *parts: asked.append(parts))
    scene = SimpleNamespace(cameras=Numbered(), posed=lambda time: ("posed", time))
    layers = np.zeros((5, 7, 2))
    for index in (None, 0, 3):
        blend_weights.blend_weight_sums(scene, 1.5, index, layers)
    posed = ("posed", 1.5)
    expected = [(posed, ("at", 1.5, 7, 5)), (posed, ("number", 0, 7, 5)), (posed, ("number", 3, 7, 5))]
    assert [parts[:2] for parts in asked] == expected and all(parts[2] is layers for parts in asked)


class Numbered:
    """A path whose cameras tell how they were asked for."""

    def at(self, time):
        return Sized("at", time)

    def __getitem__(self, index):
        return Sized("number", index)


class Sized:
    """A camera that tells which it is and how large its pictures are to be."""

    def __init__(self, *names):
        self.names = names

    def resized(self, width, height):
        return (*self.names, width, height)


@pytest.mark.parametrize(("size", "rows"), [((64, 40), 6), ((64, 39), 6), ((64, 1), 1)])
def test_total_blend_weights_are_summed_over_views(monkeypatch, size, rows):
    cameras = Frames(*size)
    asked = []

    def sums(scene, time, frame, layer):
        asked.append((time, frame, layer.shape, layer.min(), layer.max()))
        return np.array([[1.0], [10.0**frame]])

    monkeypatch.setattr(blend_weights, "blend_weight_sums", sums)
    total = blend_weights.total_blend_weights(SimpleNamespace(cameras=cameras, ids=np.arange(2)), 3, 10)
    assert asked == [(10.0 + frame, frame, (rows, 10, 1), 1, 1) for frame in (0, 2, 4)]
    assert total.tolist() == [3, 10101]


class Frames:
    """As much of a path of five cameras as sums over views need."""

    times = 10 + np.arange(5.0)

    def __init__(self, width, height):
        self.width, self.height = width, height

    def __len__(self):
        return 5


def test_masks_are_lifted_by_the_weights_inside(monkeypatch):
    """Numbers below 1, a Gaussian that nobody sees, and one whose sums differ by rounding."""
    given = {1: [[0.02, 0.05], [0, 0.1], [0, 0], [0.3 + 1e-9, 0.3]], 4: [[0.01, 0.15], [0, 0.1], [0, 0], [0, 0]]}

    def sums(scene, time, frame, layers):
        assert time == 10 + frame
        np.testing.assert_array_equal(layers, np.stack([masks[frame], np.ones((2, 3))], -1))
        return np.array(given[frame])

    masks = {1: np.arange(6).reshape(2, 3) / 6, 4: np.eye(2, 3)}
    masks = {frame: mask.astype(np.float32) for frame, mask in masks.items()}
    monkeypatch.setattr(blend_weights, "blend_weight_sums", sums)
    fraction, total = blend_weights.lift_masks(SimpleNamespace(cameras=Frames(3, 2), ids=np.arange(4)), masks)
    np.testing.assert_allclose(fraction, [0.15, 0, 0, 1], rtol=1e-12)
    np.testing.assert_allclose(total, [0.2, 0.2, 0, 0.3])
    assert fraction.max() == 1


def test_scores_of_labels_are_decoded_piece_by_piece(scene, monkeypatch):
    monkeypatch.setattr(pixels, "ROWS", 4)
    query = ask_for(scene, ["square"], ["wall", "sky"])
    latents = np.random.default_rng(1).normal(size=(2, 5, 8)).astype(np.float32)
    found = pixels.label_scores(query, latents)
    assert found.shape == (2, 5, 3) and found.dtype == np.float32
    np.testing.assert_allclose(found, text_scores(latents, VECTORS[:3], 0.1), atol=1e-6)


@pytest.mark.parametrize(("cells", "size"), [(2, (32, 20)), (4, (64, 40))])
def test_a_head_map_is_the_mean_latent_of_its_cells(scene, monkeypatch, cells, size):
    monkeypatch.setattr(pixels, "PER_CELL", cells)
    found = pixels.head_map(scene, "text", scene.cameras[2], 2.0)
    latent = render(scene, scene.cameras[2].resized(*size), 2.0, ("latent",))["latent"]
    np.testing.assert_allclose(found, latent.reshape(10, cells, 16, cells, 8).mean((1, 3)), atol=1e-5)
    fine = pixels.head_map(scene, "visual", scene.cameras[2], 2.0)  # no finer than the picture: 20 x 32 cells
    latent = render(scene, scene.cameras[2].resized(64, 40), 2.0, ("latent",))["latent"]
    if cells == 4:
        np.testing.assert_allclose(fine, latent.reshape(20, 2, 32, 2, 8).mean((1, 3)), atol=1e-5)


def test_a_text_picture_is_0_where_nothing_is(scene, wide):
    query = ask_for(scene, ["square"], ["wall"])
    drawn = render(scene, wide, 1.0, ("latent", "alpha"))
    expected = pixels.label_scores(query, drawn["latent"])
    covered = drawn["alpha"] >= COVERED
    assert 0.1 < covered.mean() < 0.9
    found = pixels.text_score_map(scene, query, wide, 1.0)
    assert found.shape == (40, 64, 2) and not found[~covered].any()
    np.testing.assert_array_equal(found[covered], expected[covered])


@pytest.mark.parametrize(("step", "size"), [(1, (40, 64)), (2, (20, 32)), (3, (13, 21)), (50, (1, 1))])
def test_a_text_picture_of_every_nth_pixel(scene, step, size):
    query = ask_for(scene, ["square"], ["wall"])
    found = pixels.text_score_map(scene, query, scene.cameras[0], 0.0, step=step)
    assert found.shape == (*size, 2)
    np.testing.assert_array_equal(
        found, pixels.text_score_map(scene, query, scene.cameras[0].resized(size[1], size[0]), 0.0)
    )


def test_coverage_counts_the_chosen_or_their_scores(scene, wide):
    scores = np.random.default_rng(2).random(len(scene.ids))
    values = np.stack([scores >= 0.5, scores], 1).astype(np.float32)
    drawn = render(scene, wide, 2.0, (), values={"both": values})["both"]
    some = chosen_by(scene, scores)
    np.testing.assert_allclose(pixels.coverage_image(scene, some, wide, 2.0), drawn[..., 0], atol=1e-6)
    np.testing.assert_allclose(pixels.coverage_image(scene, some, wide, 2.0, soft=True), drawn[..., 1], atol=1e-6)
    assert not pixels.coverage_image(scene, some.within(0, 1), wide, 2.0).any()
    assert pixels.coverage_image(scene, some.within(2, 2), wide, 2.0).any()


def test_a_mask_video_is_made_of_mattes(scene, wide):
    scores = np.random.default_rng(3).random(len(scene.ids))
    order = np.random.default_rng(4).permutation(len(scene.ids))
    shuffled = replace(chosen_by(scene, scores[order]), ids=scene.ids[order])
    views = [(wide, 0.0), (scene.cameras[1], 1.0)]
    expected = [matte.matte_image(scene, chosen_by(scene, scores), *view) for view in views]
    for shown, (camera, time), mask in zip(matte.mask_video(scene, shuffled, views), views, expected, strict=True):
        np.testing.assert_array_equal(shown.matte, mask)
        np.testing.assert_array_equal(shown.picture, render(scene, camera, time, ("rgb",))["rgb"])
        np.testing.assert_array_equal(shown.scores, pixels.coverage_by(scene, scores, camera, time))


def test_a_mask_video_is_empty_outside_the_span(scene):
    chosen = replace(chosen_by(scene, np.ones(len(scene.ids))), span=(1.0, 2.0))
    before, within = matte.mask_video(scene, chosen, [(scene.cameras[0], 0.0), (scene.cameras[1], 1.0)])
    assert not before.matte.any() and not before.scores.any() and before.picture.any()
    assert within.matte.any() and within.scores.any()


def test_a_heat_map_is_colour_over_the_grey_of_the_picture():
    """To the last digit, also of numbers out of range."""
    random = np.random.default_rng(5)
    picture, score = random.uniform(-0.3, 1.3, (9, 11, 3)), random.uniform(-0.3, 1.3, (9, 11))
    picture[0], score[0, :5], score[0, 5:] = 1, 1, 0
    found = pixels.heat_map(picture, score)
    for y, x in np.ndindex(9, 11):
        grey = np.clip(picture[y, x], 0, 1) @ [0.299, 0.587, 0.114]
        place = np.clip(score[y, x], 0, 1) * (len(SPECTRUM) - 1)
        low = min(int(place), len(SPECTRUM) - 2)
        colour = (1 - place + low) * SPECTRUM[low] + (place - low) * SPECTRUM[low + 1]
        expected = 255 * (0.6 * colour + 0.4 * grey)
        assert np.abs(found[y, x] - expected).max() <= 0.5 + 1e-6
    assert found.dtype == np.uint8


def test_leakage_is_the_fraction_of_the_chosen_weights_outside(monkeypatch):
    inside, weights = np.array([0.25, 1, 0, 0.5]), np.array([0.04, 0.1, 0.3, 0])
    monkeypatch.setattr(leakage, "lift_masks", lambda scene, masks, progress: (inside, weights))
    scene = SimpleNamespace(cameras=Frames(3, 2))
    for scores, expected in (([1, 1, 0, 1], 0.03 / 0.14), ([1, 0, 1, 0], 0.33 / 0.34), ([0, 0, 0, 1], 0)):
        some = Selection(np.arange(4), np.array(scores, float), np.zeros(4, bool))
        assert leakage.leakage(scene, some, {1: np.ones((2, 3))}) == pytest.approx(expected)


def test_without_masks_the_largest_region_of_the_own_picture_counts(monkeypatch):
    """Of pixels that are covered by more than half; frames outside the span do not count."""
    picture = np.array([[0.51, 0.9, 0.2, 0.9], [0.3, 0.6, 0.4, 0.49]])
    asked, lifted = [], {}
    monkeypatch.setattr(leakage, "VIEWS", 3)
    monkeypatch.setattr(
        leakage, "coverage_image", lambda scene, some, camera, time, backend: asked.append((camera, time)) or picture
    )
    monkeypatch.setattr(
        leakage, "lift_masks", lambda scene, masks, progress: lifted.update(masks) or (np.zeros(1), np.ones(1))
    )
    cameras = type("Path", (Frames,), {"__getitem__": lambda self, frame: f"camera {frame}"})(4, 2)
    some = Selection(np.arange(1), np.ones(1), np.zeros(1, bool), span=(11, 14))
    assert leakage.leakage(SimpleNamespace(cameras=cameras), some) == 1
    assert asked == [("camera 0", 10), ("camera 2", 12), ("camera 4", 14)] and sorted(lifted) == [2, 4]
    for mask in lifted.values():
        np.testing.assert_array_equal(mask, [[1, 1, 0, 0], [0, 1, 0, 0]])
