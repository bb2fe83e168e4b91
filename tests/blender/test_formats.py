"""Exports in Blender's own importers: they stand where the add-on puts the scene itself, and move."""

import numpy as np
import pytest
from random_scene import random_scene

from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.formats import export
from f4x_core.scene.posing import plain_color

bpy = pytest.importorskip("bpy", reason="bpy is absent")
BLENDER_FROM_SCENE = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # addon.axes: (x, y, z) to (x, z, -y)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def world_points(item):
    """(N,3) of an object's points as they are evaluated at the current frame."""
    data = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.attributes["position"].data
    flat = np.empty(3 * len(data), np.float32)
    data.foreach_get("vector", flat)
    matrix = np.array(item.matrix_world)
    return flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def test_usd_points_play(tmp_path):
    scene = random_scene()
    export(scene, tmp_path / "a.usda", np.arange(6.0), "usd-points")
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "a.usda"))
    assert bpy.data.objects["dynamic"].type == "POINTCLOUD"
    assert (bpy.context.scene.frame_start, bpy.context.scene.frame_end) == (0, 5)
    for frame in (0, 4):
        bpy.context.scene.frame_set(frame)
        posed = scene.posed(frame)
        for name, part in (("static", ~posed.dynamic), ("dynamic", posed.dynamic)):
            expected = posed.means[part] @ BLENDER_FROM_SCENE.T
            np.testing.assert_allclose(world_points(bpy.data.objects[name]), expected, atol=1e-5)
    colors = bpy.data.objects["static"].data.attributes["displayColor"].data
    assert np.allclose(colors[7].color[:3], linear_from_srgb(plain_color(scene.posed(0)))[7], atol=1e-3)


@pytest.mark.parametrize(("name", "cloud"), [("gltf", "random scene"), ("points", "static")])
def test_gltf(tmp_path, name, cloud):
    scene = random_scene(dynamic=0)
    export(scene, tmp_path / "a.glb", [0.0], name)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "a.glb"))
    expected = scene.static.means @ BLENDER_FROM_SCENE.T
    np.testing.assert_allclose(world_points(bpy.data.objects[cloud]), expected, atol=1e-5)


def test_ply(tmp_path):
    scene = random_scene(dynamic=0)
    export(scene, tmp_path / "a.ply", [0.0], "ply")
    bpy.ops.wm.ply_import(filepath=str(tmp_path / "a.ply"), forward_axis="Y", up_axis="Z")
    data = bpy.data.objects["a"].data
    found = np.empty(3 * len(scene.static), np.float32)
    data.attributes["position"].data.foreach_get("vector", found)
    np.testing.assert_allclose(found.reshape(-1, 3), scene.static.means, atol=1e-6)
    splats = {"radiance:base", "scale", "rotation"}  # what Blender 5.3 makes of them
    wanted = splats if isinstance(data, bpy.types.PointCloud) else {"opacity", "scale_0", "rot_3", "f_rest_8"}
    assert wanted <= {attribute.name for attribute in data.attributes}
