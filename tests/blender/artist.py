"""A Blender of its own for each test: a child process runs a script in the house of the extension and notes what it finds."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

_BEFORE = """
import json, os, sys
sys.path.extend(f"{sys.argv[1]}/{name}" for name in ("tools", "scripts"))
import door; door.end_at_errors()
import bpy
import numpy as np
from pathlib import Path
folder, noted, arrays, ops = Path(sys.argv[2]), {}, {}, bpy.ops.f4x
door.load_extension().register()
from feature4x.addon.operators import importing
importing._told_of_refit = True  # Blender 5.3 says it once in a session, beside what a test is about; it has a test of its own
from feature4x.addon.scene.scene_object import SceneObject
from feature4x.addon.common.point_cloud import read_attribute

def scene_object():
    return SceneObject.of(bpy.context.object)

def root():
    return scene_object().root

def push(name):
    bpy.ops.ed.undo_push(message=name)

def refused(call, *args, **options):
    try:
        call(*args, **options)
    except RuntimeError as error:
        return str(error)
    raise AssertionError("it was not refused")

def stack_in_file(name="scene.f4x"):
    from feature4x.f4x_core.edit.stack import read_stack
    return [edit.operation.TAG for edit in read_stack(folder / name).edits]

def select(*items):
    for other in bpy.context.scene.objects:
        other.select_set(other in items)
    bpy.context.view_layer.objects.active = items[0]

def show_nodes():
    from feature4x.addon.rig.scaffold import layer_of
    layer_of(root()).hide_viewport = False

def values(item, name="position"):
    return read_attribute(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data, name)
"""
_AFTER = """
np.savez(folder / "arrays.npz", **arrays)
(folder / "noted.json").write_text(json.dumps(noted))
door.end()
"""


def opened_at(frame: int) -> str:
    """Script that opens the scene of the folder in an empty file at a frame."""
    return f"""
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
bpy.context.scene.frame_set({frame})
"""


def perform(folder: Path, script: str, *arguments: Any, **environment: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run `script` in a Blender without a window; returns what it put into `noted` and `arrays`; log.txt has its output."""
    import numpy as np

    outside = {name: value for name, value in os.environ.items() if name != "F4X_PYTHON"}
    done = subprocess.run(
        [sys.executable, "-c", _BEFORE + script + _AFTER, str(ROOT), str(folder), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=600,
        env=outside | {"OMP_NUM_THREADS": "1"} | environment,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    (folder / "log.txt").write_text(done.stdout + done.stderr)
    return json.loads((folder / "noted.json").read_text()), dict(np.load(folder / "arrays.npz"))
