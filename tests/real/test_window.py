"""The window of a real Blender, used as a person would: `tools/check_window.py` on a small scene."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene
from PIL import Image, ImageStat

from f4x_core.edit.stack import of
from f4x_core.scene import read_scene, write_scene

pytestmark = [pytest.mark.real, pytest.mark.blender]
REPOSITORY = Path(__file__).resolve().parents[2]
STEPS = (
    *("0_imported", "2_text", "3_queried", "4_recoloured", "5_undone", "6_redone", "7_saved", "8_pointed", "9_boxed"),
    *("9_box", "9_brush", "9_lasso", "9_sphere"),
    *("10_rendering", "11_stopped", "12_back", "13_working", "14_cancelled", "15_covered", "16_processor"),
)
TOOLS = ("box", "brush", "lasso", "sphere")


def inner_part(box: list[float]) -> tuple[int, int, int, int]:
    """Return the middle of a box, half as wide and high."""
    left, top, right, bottom = map(int, box)
    return (3 * left + right) // 4, (3 * top + bottom) // 4, (left + 3 * right) // 4, (top + 3 * bottom) // 4


@pytest.fixture(scope="module")
def window(blender_root, tmp_path_factory) -> tuple[Path, dict]:
    """(folder of what is left, what the sidebar said after every step)."""
    folder = tmp_path_factory.mktemp("window")
    write_scene(labelled_scene(), folder / "scene.f4x")
    command = [sys.executable, str(REPOSITORY / "tools/check_window.py"), str(folder / "scene.f4x")]
    command += ["--root", str(blender_root), "--word", "square", "--shading", "RENDERED", "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    steps = json.loads(done.stdout.splitlines()[-1])
    assert tuple(steps) == STEPS
    return folder, {name.partition("_")[2]: state for name, state in steps.items()}


def test_the_clips_picture_is_seen_whole_beside_the_sidebar(window):
    _, steps = window
    left, right, sidebar = steps["queried"]["room"]  # the sidebar opens after the import
    assert 0 < left < right < sidebar and right - left > 0.8 * sidebar


def test_query_recolour_undo_redo_and_save(window):
    folder, steps = window
    square = labelled_scene().dynamic
    assert steps["queried"]["text"] == "square" and steps["queried"]["selected"] == len(square)
    assert steps["undone"]["selected"] == len(square) and [steps[s]["edits"] for s in ("undone", "redone")] == [0, 1]
    (edit,) = of(read_scene(folder / "saved.f4x")).edits
    assert edit.operation.TAG == "recolour" and set(edit.operation.select.array) == set(square.ids)


def test_click_and_box_select_the_square(window):
    _, steps = window
    count = len(labelled_scene().dynamic)
    assert steps["pointed"]["last"] == "F4X_OT_query_point" and steps["pointed"]["selected"] == count
    assert steps["boxed"]["last"] == "F4X_OT_query_box" and count / 2 < steps["boxed"]["selected"] <= count


def test_gestures_select_parts_of_the_square_and_nothing_else(window):
    """The box that was drawn holds most of the square, the brush a stripe of it, the sphere the disc inside the box."""
    _, steps = window
    count, selected = len(labelled_scene().dynamic), {name: steps[name]["selected"] for name in TOOLS}
    assert all(steps[name]["last"] == f"F4X_OT_select_{name}" for name in TOOLS)
    assert count / 2 < selected["box"] <= count and count / 2 < selected["lasso"] <= count
    assert 0 < selected["brush"] < selected["box"] and 0 < selected["sphere"] < selected["box"]


def test_render_and_job_are_stopped(window):
    _, steps = window
    assert steps["rendering"]["rendered"] == "running" and steps["stopped"]["rendered"] == "cancelled"
    assert steps["working"]["job"] == ["running"] and steps["cancelled"]["job"] == ["cancelled"]


def test_the_viewport_shows_what_was_done(window):
    """The square lies on a blue wall; it becomes redder, goes back, and stays where it is while pictures are rendered."""
    folder, steps = window
    _, top, right, bottom = map(int, steps["queried"]["thing"])
    inner = inner_part(steps["queried"]["thing"])
    beside = (right + 60, top, right + 100, bottom)

    def median(name: str, part: tuple[int, int, int, int]) -> list[int]:
        return ImageStat.Stat(Image.open(folder / f"{name}.png").convert("RGB").crop(part)).median

    before, after = median("3_queried", inner), median("4_recoloured", inner)
    assert (
        np.abs(np.subtract(before, [204, 51, 26])).max() < 20 and np.abs(np.subtract(after, [230, 26, 26])).max() < 20
    )
    assert median("5_undone", inner) == before and median("6_redone", inner) == median("14_cancelled", inner) == after
    for name in STEPS[1:9]:
        red, _, blue = median(name, beside)
        assert blue > 150 > 2 * red, name


def test_a_mesh_in_front_hides_the_pink_points_of_the_selection(window):
    """The square is red, the mesh gray and the handles of the sphere orange: only pink has more blue than green."""
    folder, steps = window
    inner = inner_part(steps["queried"]["thing"])
    more_blue = {}
    for name in ("9_sphere", "15_covered", "16_processor"):
        pixels = np.asarray(Image.open(folder / f"{name}.png").convert("RGB").crop(inner), int)
        more_blue[name] = (pixels[..., 2] - pixels[..., 1]).max()
    assert steps["covered"]["selected"] > 0
    assert more_blue["9_sphere"] > 30 and max(more_blue["15_covered"], more_blue["16_processor"]) < 5, more_blue


def test_the_graphics_card_draws_the_viewport(window):
    folder, _ = window
    assert "the processor does" not in (folder / "blender.log").read_text()


def test_a_walk_in_the_window_ends_without_anything_wrong(blender_root, tmp_path):
    """So many steps that the first new file is reached; `F4X_WALK_MINUTES=60` makes it an hour."""
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    asked = os.environ.get("F4X_WALK_MINUTES")
    minutes, steps = (10.0, 90) if asked is None else (float(asked), 10**6)
    command = [sys.executable, str(REPOSITORY / "tools/walk_window.py"), str(tmp_path / "scene.f4x")]
    command += ["--root", str(blender_root), "--out", str(tmp_path), "--seed", "3"]
    command += ["--minutes", str(minutes), "--steps", str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60 * minutes + 1200)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["steps"] == steps or asked is not None
    assert result["steps"] > 20 and result["memory"][0] > 0
