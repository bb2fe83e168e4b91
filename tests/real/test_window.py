"""The window of a real Blender, used as a person would: `scripts/check_window.py` on a small scene."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.stack import of
from f4x_core.scene import read_scene, write_scene

pytestmark = [pytest.mark.real, pytest.mark.blender]
REPOSITORY = Path(__file__).resolve().parents[2]
CHROOT = Path(os.environ.get("F4X_BLENDER_ROOT", "/nowhere"))
"""A system with Blender, Xvfb and xdotool to chroot into."""


@pytest.mark.skipif(not (CHROOT / "usr/bin/blender").exists(), reason="F4X_BLENDER_ROOT names no system with Blender")
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may chroot")
def test_query_recolour_undo_redo_and_save_with_mouse_and_keyboard(tmp_path):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    command = [sys.executable, str(REPOSITORY / "scripts/check_window.py"), str(tmp_path / "scene.f4x")]
    command += ["--root", str(CHROOT), "--word", "square", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout)
    saved, before = read_scene(tmp_path / "out/saved.f4x"), read_scene(tmp_path / "scene.f4x")
    (edit,) = of(saved).edits
    assert edit.operation.TAG == "recolour"
    assert set(edit.operation.select.array) == set(before.dynamic.ids)
