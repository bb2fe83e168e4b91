"""What the cells of a picture show, against the formulas written out, and that each picture is drawn once."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, SQUARE, STEP, WIDTH, labelled_scene

from f4x_core.geometry import spherical_harmonics
from f4x_core.query import views
from f4x_core.query.blend_weights import blend_weight_sums
from f4x_core.query.following import decoder_of
from f4x_core.query.pixels import head_map
from f4x_core.query.views import CUES, Views, views_of
from f4x_core.scene.view import render


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


def cues_by_cells(scene, frame, rows, columns):
    """(rows,columns,6) speed, moving, depth and colour as numbers from 0 to 1, cell by cell; a cell is whole pixels."""
    camera, time = scene.cameras[frame], float(scene.cameras.times[frame])
    values = {"moving": scene.moving[:, None].astype(np.float32)}
    drawn = render(scene, camera, time, ("rgb", "depth", "motion"), values=values)
    result = np.zeros((rows, columns, 6))
    down, across = HEIGHT // rows, WIDTH // columns
    for y, x in np.ndindex(rows, columns):
        cell = np.s_[y * down : (y + 1) * down, x * across : (x + 1) * across]
        speed = np.linalg.norm(drawn["motion"][cell], axis=-1) / WIDTH / 0.008
        depth = drawn["depth"][cell]
        near = np.where(np.isnan(depth), 0, 1 / (1 + depth))
        colour = np.clip(drawn["rgb"][cell], 0, 1).mean((0, 1))
        result[y, x] = np.tanh(speed).mean(), drawn["moving"][cell].mean(), near.mean(), *colour
    return result


def cosines(cells):
    flat = cells.reshape(-1, cells.shape[-1])
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    return flat @ flat.T


def test_a_cell_shows_its_features_and_cues(scene):
    found = views._cells(scene, 2, "auto")
    assert found.shape == (20, 32, 12 + 8) and found.dtype == np.float32
    angle = np.pi / 2 * cues_by_cells(scene, 2, 20, 32)
    weight = np.array([0.8, 0.5, 1, 1, 1, 1])
    np.testing.assert_allclose(found[..., :6], weight * np.cos(angle), atol=1e-4)
    np.testing.assert_allclose(found[..., 6:12], weight * np.sin(angle), atol=1e-4)
    looks = head_map(scene, "visual", scene.cameras[2], 2.0)
    looks /= np.maximum(np.linalg.norm(looks, axis=-1, keepdims=True), 1e-12)
    np.testing.assert_allclose(found[..., 12:], looks, atol=1e-4)
    speed = np.tanh(60 * STEP / SQUARE / WIDTH / 0.008)  # the square's, by focal length, step and depth
    assert np.arctan2(found[..., 6], found[..., 0]).max() / (np.pi / 2) == pytest.approx(speed, rel=0.02)
    assert list(CUES.values()) == [0.8, 0.5, 1, 1]


def test_appearance_keeps_the_cosines(scene, monkeypatch):
    """Of all frames, though three tell its directions; the scene has fewer directions than are kept."""
    kept = Views()
    for frame in (1, 5):
        found = kept.appearance(scene, frame)
        assert found.shape == (20, 32, views.DIRECTIONS)
        np.testing.assert_allclose(cosines(found), cosines(views._cells(scene, frame, "auto")), atol=1e-3)
    monkeypatch.setattr(views, "DIRECTIONS", 2)
    few = Views().appearance(scene, 1)
    flat = np.concatenate([views._cells(scene, t, "auto").reshape(640, -1) for t in (0, 2, 5)])
    top = np.linalg.svd(flat.astype(float), full_matrices=False)[2][:2]
    np.testing.assert_allclose(cosines(few), cosines(views._cells(scene, 1, "auto") @ top.T), atol=1e-4)


def test_colour_motion_and_depth_are_all_where_features_are_missing(monkeypatch):
    """Colours brighter than white, and a picture that shows past the wall."""
    scene = labelled_scene(features=False)
    sh = spherical_harmonics.dc_from_rgb(np.float32([1.3, 0.4, -0.2])) * np.ones((len(scene.static), 1, 1), np.float32)
    intrinsics = scene.cameras.intrinsics * np.float64([[0.4, 1, 1], [1, 0.4, 1], [1, 1, 1]])
    scene = replace(scene, static=replace(scene.static, sh=sh), cameras=replace(scene.cameras, intrinsics=intrinsics))
    monkeypatch.setattr(views, "GRID", 16)
    drawn = render(scene, scene.cameras[2], 2.0, ("rgb", "depth"))
    assert np.isnan(drawn["depth"]).any() and drawn["rgb"].max() > 1.1
    angle = np.pi / 2 * cues_by_cells(scene, 2, 10, 16)
    found = views._cells(scene, 2, "auto")
    np.testing.assert_allclose(found[..., 6:], np.array([0.8, 0.5, 1, 1, 1, 1]) * np.sin(angle), atol=1e-4)
    np.testing.assert_allclose(cosines(Views().appearance(scene, 2)), cosines(found), atol=1e-3)
    text = replace(labelled_scene().features, heads=labelled_scene().features.heads[:1])
    assert views._cells(replace(scene, features=text), 2, "auto").shape == (10, 16, 12)
    flat = replace(scene, cameras=replace(scene.cameras, height=1))
    assert views._cells(flat, 0, "auto").shape == (1, 16, 12)


def test_a_decoder_sees_the_appearance_of_each_frame(scene):
    decoder = decoder_of(scene)
    assert decoder.count == FRAMES and decoder.size == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(decoder._features(4), views_of(scene).appearance(scene, 4))


def test_who_shows_in_a_picture_and_where(scene):
    rows, weights, (row, column) = Views().seen(scene, 2)
    layers = np.ones((HEIGHT, WIDTH, 1), np.float32)
    sums = blend_weight_sums(scene, 2.0, 2, layers)[:, 0]
    np.testing.assert_array_equal(rows, np.flatnonzero(sums > views.UNSEEN))
    np.testing.assert_allclose(weights, sums[rows], rtol=1e-6)
    pixels, _ = scene.cameras[2].project(scene.posed(2.0).means[rows].astype(float))
    inner = (pixels > 2).all(1) & (pixels < [WIDTH - 2, HEIGHT - 2]).all(1) & scene.moving[rows]
    assert inner.sum() > 10 and (abs(np.stack([column, row], 1) + 0.5 - pixels)[inner] < 1).all()


def test_each_picture_is_drawn_once(scene, monkeypatch):
    kept = Views()
    shown, seen = [kept.appearance(scene, t) for t in range(FRAMES)], kept.seen(scene, 3)
    monkeypatch.setattr(views, "render", None)
    monkeypatch.setattr(views, "blend_weight_sums", None)
    assert all(kept.appearance(scene, t) is shown[t] for t in range(FRAMES)) and kept.seen(scene, 3) is seen
    assert views_of(scene) is views_of(scene) and views_of(scene) is not views_of(replace(scene))
