"""Frames on a farm: what `blender -b SHOT.blend -E FEATURE4X -s A -e B -a` leaves on nodes is one machine's, byte by byte."""

import subprocess
import sys
from pathlib import Path

import pytest
from labelled_scene import FRAMES, labelled_scene

from f4x_core.scene import write_scene

pytestmark = pytest.mark.blender
pytest.importorskip("bpy", reason="bpy is absent")
SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"

# What a node does: a Blender with the extension opens the file and renders its range of frames, as `-a` does.
NODE = """
import os, sys
sys.excepthook = lambda *error: (sys.__excepthook__(*error), sys.stderr.flush(), os._exit(1))  # bpy 4.5 would hang
scripts, blend, out, first, last, kind = sys.argv[1:]
sys.path.insert(0, scripts)
import bpy, door
door.start_blender()
bpy.ops.wm.open_mainfile(filepath=blend)
scene = bpy.context.scene
scene.render.engine = "FEATURE4X"
scene.frame_start, scene.frame_end = int(first), int(last)
scene.render.filepath = out + "/frame_####"
scene.render.image_settings.file_format = kind
bpy.ops.render.render(animation=True)
os._exit(0)
"""


def python(*command):
    done = subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def frames_of(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("kind", ["PNG", "OPEN_EXR_MULTILAYER"])
def test_ranges_on_several_nodes_are_the_frames_of_one_machine(tmp_path, kind):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    python(SCRIPTS / "import_scene.py", tmp_path / "scene.f4x", tmp_path / "shot.blend")
    (tmp_path / "scene.f4x").unlink()  # a node needs the .blend alone
    ranges = {"one": [(0, FRAMES - 1)], "farm": [(FRAMES // 2, FRAMES - 1), (0, FRAMES // 2 - 1)]}
    for name, nodes in ranges.items():
        for first, last in nodes:
            python("-c", NODE, SCRIPTS, tmp_path / "shot.blend", tmp_path / name, first, last, kind)
    one, farm = frames_of(tmp_path / "one"), frames_of(tmp_path / "farm")
    assert len(one) == FRAMES and one == farm
    assert len(set(one.values())) == FRAMES, "the scene moves"
