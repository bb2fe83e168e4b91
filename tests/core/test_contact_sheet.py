"""The contact sheet of a small random scene."""

import dataclasses

import numpy as np
import pytest
from random_scene import FRAMES, HEIGHT, WIDTH, random_scene

from f4x_core.clip import Clip
from f4x_core.clip.images import as_bytes
from f4x_core.errors import F4xError
from f4x_core.evaluation.contact_sheet import COLUMNS, contact_sheet
from f4x_core.scene.moments import centre_depth
from f4x_core.scene.view import render
from f4x_core.scene.visualise import GAP, LABEL_HEIGHT, MARGIN


def clip_like(frames: int = FRAMES, width: int = WIDTH, height: int = HEIGHT) -> Clip:
    rgb = np.random.default_rng(1).integers(0, 256, (frames, height, width, 3), dtype=np.uint8)
    return Clip("noise", rgb, np.arange(frames, dtype=float), 24.0, np.zeros(frames, bool), "noise")


def cell(sheet: np.ndarray, row: int, column: str, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    left = MARGIN + COLUMNS.index(column) * (width + GAP)
    top = LABEL_HEIGHT + row * (height + GAP)
    return sheet[top : top + height, left : left + width]


def test_cells_show_what_their_labels_say():
    scene, clip = random_scene(), clip_like()
    seen = []
    sheet = np.asarray(
        contact_sheet(scene, clip, frames=3, progress=lambda stage, done, total, message="": seen.append(done))
    )
    assert sheet.shape == (LABEL_HEIGHT + 3 * (HEIGHT + GAP), MARGIN + len(COLUMNS) * (WIDTH + GAP), 3)
    assert seen == [0, 1, 2, 3]
    for row, frame in enumerate((0, 2, 5)):
        drawn = as_bytes(render(scene, scene.cameras[frame], float(frame), ("rgb",))["rgb"])
        np.testing.assert_array_equal(cell(sheet, row, "input"), clip.frames[frame])
        np.testing.assert_array_equal(cell(sheet, row, "render"), drawn)
        for aside in ("from the right", "from above"):
            assert np.abs(cell(sheet, row, aside).astype(int) - drawn).mean() > 2  # another view, not a black one
            assert cell(sheet, row, aside).mean() > 0.5 * drawn.mean()
    assert (sheet[:LABEL_HEIGHT, MARGIN:] < 128).any() and (sheet[LABEL_HEIGHT:, :MARGIN] < 128).any()  # labels
    assert (sheet[:LABEL_HEIGHT, :MARGIN] < 128).any()  # "frame" above the numbers
    assert (cell(sheet, 0, "motion").astype(int) != 255).any()  # something moves


def test_a_still_scene_has_a_white_motion_column():
    scene = random_scene(dynamic=0)
    sheet = np.asarray(contact_sheet(scene, clip_like(), frames=2))
    assert (cell(sheet, 0, "motion") == 255).all()
    assert len(np.unique(cell(sheet, 0, "depth").reshape(-1, 3), axis=0)) > 10


def test_wide_clips_are_shrunk_and_short_ones_give_fewer_rows():
    scene = random_scene(static=5, dynamic=0)
    scene = dataclasses.replace(scene, cameras=scene.cameras.resized(640, 400))
    sheet = contact_sheet(scene, clip_like(width=640, height=400), frames=20)
    assert sheet.size == (MARGIN + len(COLUMNS) * (320 + GAP), LABEL_HEIGHT + FRAMES * (200 + GAP))


def test_portrait_clips_keep_their_shape():
    scene = random_scene(static=5, dynamic=0)
    scene = dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, width=HEIGHT, height=WIDTH))
    sheet = contact_sheet(scene, clip_like(width=HEIGHT, height=WIDTH), frames=2)
    assert sheet.size == (MARGIN + len(COLUMNS) * (HEIGHT + GAP), LABEL_HEIGHT + 2 * (WIDTH + GAP))


def test_the_centre_of_views_aside_is_what_the_middle_shows():
    depth = np.full((30, 60), 9.0)
    depth[10:20, 20:40] = 0.7
    assert centre_depth(depth) == pytest.approx(0.7)
    assert centre_depth(np.full((30, 60), 40.0)) == 1.5 and centre_depth(np.full((30, 60), 0.01)) == 0.3
    assert centre_depth(np.full((30, 60), np.nan)) == 1.0


def test_another_clip_is_refused():
    with pytest.raises(F4xError, match="4 frames, but the scene has 6"):
        contact_sheet(random_scene(), clip_like(4))
