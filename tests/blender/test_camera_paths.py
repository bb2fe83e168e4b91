"""Cameras on paths of their own, and films of the worker along them."""

import sys

import numpy as np
import pytest
from labelled_scene import FRAMES, labelled_scene

from f4x_core.clip.read import read_clip
from f4x_core.geometry import trajectory

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
"""


@pytest.mark.parametrize("path", ["STABILISE", "ORBIT"])
def test_a_camera_goes_the_cores_way(folder, path):
    script = f"""
before = bpy.context.scene.camera
ops.add_path_camera(path="{path}", degrees=8.0, calm=3.0)
camera = bpy.context.scene.camera
noted["new"], noted["parent"] = camera != before, camera.parent == root()
places = []
for frame in range({FRAMES}):
    bpy.context.scene.frame_set(frame)
    places.append(np.array(root().matrix_world.inverted() @ camera.matrix_world))
arrays["places"] = np.stack(places)
"""
    noted, arrays = perform(folder, START + script)
    cameras = labelled_scene().cameras
    views = trajectory.stabilised(cameras, 3.0) if path == "STABILISE" else trajectory.orbit(cameras, degrees=8.0)
    expected = np.linalg.inv([view.camera.world_to_camera for view in views]) @ np.diag([1, -1, -1, 1])
    np.testing.assert_allclose(arrays["places"], expected, atol=1e-5)
    assert noted == {"new": True, "parent": True}


def test_a_film_is_rendered_by_the_worker(folder):
    script = f"""
from feature4x.addon.operators import tasks
tasks.worker_python = lambda: {sys.executable!r}
ops.render_film(path="slow", factor=2.0)
ops.render_film(path="bullet", frame=2, degrees=10.0, exr=True, output=str(folder / "stopped"))
ops.change_selection(how="ALL")
ops.recolour(rgb=(1, 0, 0))
noted["unsaved"] = refused(ops.render_film, path="slow")
"""
    noted, _ = perform(folder, START + script)
    slow = read_clip(folder / "scene_slow" / "rgb.mp4")
    assert len(slow.frames) == 2 * FRAMES - 1
    assert len(list((folder / "stopped").glob("*.exr"))) == FRAMES + trajectory.BULLET
    assert "unsaved edits" in noted["unsaved"]
