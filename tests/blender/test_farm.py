"""Frames on a farm: what `blender -b SHOT.blend -E FEATURE4X -s A -e B -a` leaves on nodes is one machine's, byte by byte."""

import subprocess
import sys
from pathlib import Path

import pytest
from labelled_scene import FRAMES, labelled_scene

from f4x_core.edit.apply import base_of, with_operations
from f4x_core.edit.operations import Transform
from f4x_core.edit.selects import Moving
from f4x_core.scene import write_scene

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"

# What a node does: a Blender with the extension opens the file and renders its range of frames, as `-a` does.
PACK = """
import sys
scripts, blend = sys.argv[1:]
sys.path.insert(0, scripts)
import door; door.end_at_errors()
import bpy
door.start_blender()
bpy.ops.wm.open_mainfile(filepath=blend)
bpy.context.view_layer.objects.active = bpy.data.objects["labelled"]
bpy.ops.f4x.pack_scene()
bpy.ops.wm.save_mainfile()
door.end()
"""
NODE = """
import sys
scripts, blend, out, first, last, kind, engine = sys.argv[1:]
sys.path.insert(0, scripts)
import door; door.end_at_errors()
import bpy
door.start_blender()
bpy.ops.wm.open_mainfile(filepath=blend)
bpy.ops.preferences.addon_enable(module="cycles")
scene = bpy.context.scene
scene.render.engine = engine
scene.cycles.samples = 1
scene.frame_start, scene.frame_end = int(first), int(last)
scene.render.filepath = out + "/frame_####"
if hasattr(scene.render.image_settings, "media_type"):  # from 5.0 on
    scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE" if "MULTILAYER" in kind else "IMAGE"
scene.render.image_settings.file_format = kind
bpy.ops.render.render(animation=True)
door.end()
"""


def python(*command, fails=False):
    done = subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True, timeout=120)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


def frames_of(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("kind", ["PNG", "OPEN_EXR_MULTILAYER"])
def test_ranges_on_several_nodes_are_the_frames_of_one_machine(folder, kind):
    python(SCRIPTS / "import_scene.py", folder / "scene.f4x", folder / "shot.blend")
    (folder / "scene.f4x").unlink()  # a node needs the .blend alone
    ranges = {"one": [(0, FRAMES - 1)], "farm": [(FRAMES // 2, FRAMES - 1), (0, FRAMES // 2 - 1)]}
    for name, nodes in ranges.items():
        for first, last in nodes:
            python("-c", NODE, SCRIPTS, folder / "shot.blend", folder / name, first, last, kind, "FEATURE4X")
    one, farm = frames_of(folder / "one"), frames_of(folder / "farm")
    assert len(one) == FRAMES and one == farm
    assert len(set(one.values())) == FRAMES, "the scene moves"


def edited_blend(folder):
    """A .blend whose scene moves by an edit that the scene file is needed for."""
    moved = with_operations(
        labelled_scene(), Transform(Moving(), translate=(0.3, 0.0, 0.0), frames=(0.0, FRAMES - 1.0))
    )
    write_scene(base_of(moved), folder / "scene.f4x")
    python(SCRIPTS / "import_scene.py", folder / "scene.f4x", folder / "shot.blend")


@pytest.mark.parametrize("engine", ["FEATURE4X", "CYCLES"])
def test_a_node_without_the_scene_file_that_an_edit_needs_fails(tmp_path, engine):
    edited_blend(tmp_path)
    (tmp_path / "scene.f4x").unlink()
    arguments = (SCRIPTS, tmp_path / "shot.blend", tmp_path / "out", 0, FRAMES - 1, "PNG", engine)
    said = python("-c", NODE, *arguments, fails=True)
    assert "Error: " in said and "scene.f4x cannot be read" in said and "Pack Scene" in said
    assert not (tmp_path / "out").exists() or not frames_of(tmp_path / "out")


def test_a_packed_scene_needs_the_blend_alone(tmp_path):
    edited_blend(tmp_path)
    arguments = (0, FRAMES - 1, "PNG", "FEATURE4X")
    python("-c", NODE, SCRIPTS, tmp_path / "shot.blend", tmp_path / "with", *arguments)
    python("-c", PACK, SCRIPTS, tmp_path / "shot.blend")
    (tmp_path / "scene.f4x").unlink()
    python("-c", NODE, SCRIPTS, tmp_path / "shot.blend", tmp_path / "without", *arguments)
    assert len(frames_of(tmp_path / "with")) == FRAMES and frames_of(tmp_path / "with") == frames_of(
        tmp_path / "without"
    )
