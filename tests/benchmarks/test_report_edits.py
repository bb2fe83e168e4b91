"""Edits against a true object index: the labelled square, seen by the clip's cameras and by one that looks from aside."""

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene

from benchmarks.quality import labels
from benchmarks.quality.edits_against_truth import EDITS, score_edits
from f4x_core.cli import main
from f4x_core.errors import F4xError
from f4x_core.evaluation.truth import ExtraCamera, TrueClip
from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import write_scene
from f4x_core.scene.view import render

SUBJECT, OTHER = 7.0, 3.0
STEP_ASIDE = 0.1
"""World units between the clip's camera and the extra one."""
REACHED = {"recolour": 0.95, "delete": 0.75}
"""A red square of 12 pixels before blue: that it is gone is also seen in pixels at its rim that show little of it."""


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture
def truth(scene, monkeypatch, tmp_path):
    """A folder with the truth of `scene`, whose passes are drawn when they are asked for."""
    aside = scene.cameras.world_to_camera.copy()
    aside[:, 0, 3] -= STEP_ASIDE
    path = CameraPath(scene.cameras.intrinsics[::2], aside[::2], scene.cameras.times[::2], WIDTH, HEIGHT)
    cameras = {"truth": scene.cameras, "truth_aside": path}
    extras = [ExtraCamera("aside", path, tmp_path / "images_aside", tmp_path / "truth_aside", 10.0)]
    clip = TrueClip(tmp_path, scene.cameras, [7], extras, np.arange(FRAMES), (1.0, np.eye(3), np.zeros(3)), 1.0, False)
    monkeypatch.setattr(TrueClip, "read", classmethod(lambda cls, scene, folder: clip))
    (tmp_path / "truth_aside").mkdir()

    def passes(file):
        time = float(file.stem)
        drawn = render(scene, cameras[file.parent.name].at(time), time, (), values={"s": scene.moving[:, None]})["s"]
        return {"Object Index": np.where(drawn[..., 0] > 0.5, SUBJECT, OTHER)}

    monkeypatch.setattr(labels, "read_passes", passes)
    return tmp_path


def test_right_selections_reach_the_truth_in_every_view(scene, truth):
    scores = score_edits(scene, truth, "square")
    for prompt in ("mask", "text", "moving", "truth"):
        for edit in EDITS:
            for kind in ("original", "novel"):
                assert scores[f"{prompt}_{edit}_iou_{kind}"] > REACHED[edit], (prompt, edit, kind)
                assert scores[f"{prompt}_{edit}_leakage_{kind}"] < 0.02, (prompt, edit, kind)


def test_a_wrong_word_is_seen(scene, truth):
    scores = score_edits(scene, truth, "wall")
    assert scores["text_recolour_iou_novel"] < 0.2 and scores["text_delete_leakage_original"] > 0.7


def test_a_subject_nobody_sees_is_one_sentence(scene, truth, monkeypatch):
    empty = {"Object Index": np.full((HEIGHT, WIDTH), OTHER)}
    monkeypatch.setattr(labels, "read_passes", lambda file: empty)
    with pytest.raises(F4xError, match="none of the pictures"):
        score_edits(scene, truth)


def test_the_command_line_adds_them(scene, truth, capsys):
    write_scene(scene, truth / "square.f4x")
    assert main(["bench", "edit", "--scene", str(truth / "square.f4x"), "--truth", str(truth)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    (row,) = (row for row in rows if row[:1] == ["moving_recolour_iou_novel"])
    assert not any(row[0].startswith("text_") for row in rows if row)  # no --label
    assert float(row[1]) > 0.95 and row[2:] == [">=", "0.85"]
    assert main(["bench", "edit", "--truth", str(truth)]) == 2
    assert "--scene" in capsys.readouterr().err
