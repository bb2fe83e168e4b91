"""A scene file in Blender: the geometry nodes pose the Gaussians as the core does, the camera sees what it saw."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.linear import fitted_look, linear_look

from .tiny_scene import CLIP, tiny_scene

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "import_scene.py"
DOOR = f"import sys; sys.path.insert(0, {str(SCRIPT.parent)!r}); import door\n"

# What the child does in Blender: open the .blend, play it, and hand back what an artist would see.
PROBE = (
    DOOR
    + """
import bpy, json
import numpy as np
blend, out, frames = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
bpy.ops.wm.open_mainfile(filepath=blend)
scene = bpy.context.scene

def values(item, name, key, width):
    data = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.attributes[name].data
    flat = np.empty(len(data) * width, np.int32 if name == "gid" else np.float32)
    data.foreach_get(key, flat)
    return flat.reshape(-1, width)

def look(label):
    for kind in ("static", "dynamic"):
        item = bpy.data.objects[f"tiny {kind}"]
        found[f"{label}/{kind}/position"] = values(item, "position", "vector", 3)
        found[f"{label}/{kind}/rotation"] = values(item, "rotation", "value", 4)
    camera = scene.camera
    depsgraph = bpy.context.evaluated_depsgraph_get()
    r = scene.render
    projection = camera.calc_matrix_camera(depsgraph, x=r.resolution_x, y=r.resolution_y,
                                           scale_x=r.pixel_aspect_x, scale_y=r.pixel_aspect_y)
    root = bpy.data.objects["tiny"].matrix_world
    found[f"{label}/view"] = np.array(projection @ camera.matrix_world.inverted() @ root)

found = {}
for frame in frames:
    scene.frame_set(frame)
    look(str(frame))
for kind in ("static", "dynamic"):
    item = bpy.data.objects[f"tiny {kind}"]
    found[f"{kind}/gid"] = values(item, "gid", "value", 1)
    found[f"{kind}/scale"] = values(item, "scale", "vector", 3)
    found[f"{kind}/rgb"] = values(item, "rgb", "color", 4)
    found[f"{kind}/sh_0"] = values(item, "radiance:sh_0", "vector", 3)
node = bpy.data.objects["tiny node 00003"]
node.animation_data_clear()
node.location.x += 0.5
bpy.context.view_layer.update()
look("moved")
r = scene.render
found["settings"] = np.array([r.resolution_x, r.resolution_y, r.fps / r.fps_base, scene.frame_start, scene.frame_end])
np.savez(out, **found)
door.end()
"""
)


def run(*command: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """The scene as written and read back, and what Blender makes of it."""
    folder = tmp_path_factory.mktemp("import")
    file, blend, out = folder / "tiny.f4x", folder / "tiny.blend", folder / "seen.npz"
    write_scene(tiny_scene(), file)
    done = run(str(SCRIPT), str(file), str(blend))
    assert done.returncode == 0, done.stderr
    done = run("-c", PROBE, str(blend), str(out), json.dumps(list(range(CLIP))))
    assert done.returncode == 0, done.stderr
    return read_scene(file), dict(np.load(out))


def rotation_error(a, b) -> float:
    """Largest difference of quaternions, q and -q being the same rotation."""
    return np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1)).max()


@pytest.mark.parametrize("frame", range(CLIP))
def test_geometry_nodes_pose_like_the_core(seen, frame):
    scene, found = seen
    posed = scene.posed(frame)
    for kind, part in (("static", ~posed.dynamic), ("dynamic", posed.dynamic)):
        error = np.abs(found[f"{frame}/{kind}/position"] - posed.means[part]).max()
        turned = rotation_error(found[f"{frame}/{kind}/rotation"], posed.quats[part])
        print(f"frame {frame} {kind}: position error {error:.1e}, rotation error {turned:.1e}")
        assert error < 1e-5 and turned < 1e-5


def test_something_moves(seen):
    _, found = seen
    assert np.abs(found["6/dynamic/position"] - found["0/dynamic/position"]).max() > 0.3


def test_an_artist_moves_a_node(seen):
    scene, found = seen
    follows = ((scene.dynamic.node == 3) & (scene.dynamic.weight > 1e-3)).any(1) & (scene.dynamic.strength > 1e-3)
    moved = np.abs(found["moved/dynamic/position"] - found["6/dynamic/position"]).max(1)
    assert follows.any() and (moved[follows] > 1e-5).all()
    assert moved[~(scene.dynamic.node == 3).any(1)].max() < 1e-6


@pytest.mark.parametrize("frame", [0, 3, 6])
def test_blender_camera_projects_like_the_clip(seen, frame):
    scene, found = seen
    camera = scene.cameras[frame]
    points = scene.posed(frame).means.astype(np.float64)
    clip = np.concatenate([points, np.ones((len(points), 1))], 1) @ found[f"{frame}/view"].astype(np.float64).T
    ndc = clip[:, :2] / clip[:, 3:]
    pixels = (np.array([0.5, -0.5]) * ndc + 0.5) * [camera.width, camera.height]
    assert np.abs(pixels - camera.project(points)[0]).max() < 1e-3


def test_attributes_and_settings(seen):
    scene, found = seen
    for kind, gaussians in (("static", scene.static), ("dynamic", scene.dynamic)):
        assert (found[f"{kind}/gid"][:, 0] == gaussians.ids).all()
        rows = slice(0, len(gaussians)) if kind == "static" else slice(len(scene.static), None)
        splats = "type" in pytest.importorskip("bpy").types.PointCloud.bl_rna.properties
        wanted = (linear_look if splats else fitted_look)(scene).scales[rows]
        np.testing.assert_array_equal(found[f"{kind}/scale"], wanted)
        assert np.allclose(found[f"{kind}/rgb"][:, 3], gaussians.opacities)
        turned = spherical_harmonics.rotate(gaussians.sh, quaternion.normalize(gaussians.quats))
        assert np.allclose(found[f"{kind}/sh_0"], turned[:, 1], atol=1e-6)
    assert np.allclose(found["settings"], [96, 64, 23.976, 0, CLIP - 1], atol=1e-3)


@pytest.mark.parametrize("content", [None, b"not a scene"])
def test_a_bad_file_is_one_sentence(tmp_path, content):
    file = tmp_path / "broken.f4x"
    if content is not None:
        file.write_bytes(content)
    done = run(str(SCRIPT), str(file), str(tmp_path / "out.blend"))
    assert done.returncode == 2
    assert "broken.f4x" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out.blend").exists()


def test_blender_without_the_two_dashes_is_told_so():
    """Blender names itself first, and without `--` every argument is its own."""
    start = f"import sys; sys.argv[0] = 'blender'; sys.path.insert(0, {str(SCRIPT.parent)!r}); import import_scene"
    done = run("-c", start, "-b", "-P", str(SCRIPT), "tiny.f4x", "tiny.blend")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "write -- before" in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="no such limits there")
def test_a_full_disk_is_named(tmp_path):
    file = tmp_path / "tiny.f4x"
    write_scene(tiny_scene(), file)
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000)); import runpy, sys"
    start = f"{limited}; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    done = run("-c", start, str(SCRIPT), str(file), str(tmp_path / "out.blend"))
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "out.blend" in done.stderr and "File too large" in done.stderr
    assert not (tmp_path / "out.blend").exists()
