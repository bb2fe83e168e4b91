"""The child process that makes a mesh for Blender: the same mesh as in this process, and an end when nobody wants it any more."""

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene
from shapes import carried_sphere, plane, static_scene

from f4x_core.edit.apply import edited
from f4x_core.edit.meshing import MeshTask
from f4x_core.edit.operations import Duplicate
from f4x_core.edit.resolve import EditorState, resolve
from f4x_core.edit.selects import Ids
from f4x_core.edit.stack import EditStack, with_stack
from f4x_core.scene import write_scene
from f4x_core.scene.mesh import MeshConfig, SplatMesh, mesh_of

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIG = MeshConfig(24, 600)
WITHOUT_PACKAGES = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"torch", "rich", "scipy", "cv2", "av", "trimesh", "OpenEXR"}:
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
from f4x_core.edit.meshing import MeshTask
sys.exit(MeshTask.main(sys.argv[1:]))
"""


def run(*arguments, **options):
    """Lines that the child printed, and its exit code."""
    command = [sys.executable, "-c", WITHOUT_PACKAGES, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY, timeout=120, **options)
    return [json.loads(line) for line in done.stdout.splitlines()], done.returncode


def task_file(folder: Path, edits: str, ids: np.ndarray, time: float | None) -> Path:
    """Write the task of a mesh of the scene in a folder into a file."""
    task = MeshTask(str(folder / "scene.f4x"), edits, ids.tolist(), time, asdict(CONFIG), str(folder / "made.npz"))
    task.write(folder / "task.json")
    return folder / "task.json"


def assert_same(made: SplatMesh, expected: SplatMesh) -> None:
    for name in ("vertices", "faces", "normals", "colors"):
        np.testing.assert_array_equal(getattr(made, name), getattr(expected, name))
        assert getattr(made, name).dtype == getattr(expected, name).dtype
    assert made.parts == expected.parts and (made.skin is None) == (expected.skin is None)
    if expected.skin is not None:
        assert made.skin.time == expected.skin.time
        for name in ("node", "weight", "strength"):
            np.testing.assert_array_equal(getattr(made.skin, name), getattr(expected.skin, name))


@pytest.mark.parametrize("time", [None, 3.0])
def test_a_child_without_any_package_makes_the_same_mesh(tmp_path, time):
    """Of a scene with a copy that is pending in Blender alone, not in the file."""
    scene = carried_sphere(strength=0.9)
    write_scene(scene, tmp_path / "scene.f4x")
    copy = resolve(scene, Duplicate(Ids.of(scene.dynamic.ids), (2.0, 0.0, 0.0)), EditorState(None, 0.0))
    stack = EditStack().append(copy)
    changed = edited(with_stack(scene, stack))
    ids = changed.ids[np.isin(changed.ids, scene.dynamic.ids)]
    lines, code = run(task_file(tmp_path, json.dumps(stack.to_json()), ids, time), stdin=subprocess.DEVNULL)
    expected = mesh_of(changed, np.isin(changed.ids, ids), time, CONFIG)
    assert code == 0 and lines[-1]["result"] == {"faces": len(expected.faces), "parts": 1}
    assert {"scene", "mesh"} <= {line.get("stage") for line in lines}
    assert expected.skin is not None
    assert_same(SplatMesh.read(tmp_path / "made.npz"), expected)


def test_what_stands_still_has_no_skin_in_a_file_either(tmp_path):
    scene = static_scene(*plane(), 0.03)
    mesh = mesh_of(scene, np.ones(len(scene.ids), bool), 0.0, CONFIG)
    assert mesh.skin is None
    mesh.write(tmp_path / "mesh.npz")
    assert_same(SplatMesh.read(tmp_path / "mesh.npz"), mesh)


def test_too_little_and_too_few_files_are_refused_in_a_sentence(tmp_path):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    lines, code = run(task_file(tmp_path, "[]", np.arange(2), None), stdin=subprocess.DEVNULL)
    assert code == 2 and "a surface needs" in lines[-1]["error"] and not (tmp_path / "made.npz").exists()
    lines, code = run(stdin=subprocess.DEVNULL)
    assert code == 2 and "name one file" in lines[-1]["error"]
