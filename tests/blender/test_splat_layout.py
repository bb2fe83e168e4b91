"""What Blender 5.3 draws as splats: names, types and values of the point attributes, and the kind of point cloud."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from random_scene import random_scene

from f4x_core.scene import write_scene

ROOT = Path(__file__).resolve().parents[2]

CODE = """
import sys
sys.path.insert(0, sys.argv[1] + "/scripts")
import bpy, door
import numpy as np

door.end_at_errors()

has_splats = "type" in bpy.types.PointCloud.bl_rna.properties
if sys.argv[3] == "5.3" and not has_splats:  # as far as an older Blender can be made to look like it
    kinds = (("POINTS", "Points", ""), ("GAUSSIAN_SPLAT", "3D Gaussian Splats", ""))
    bpy.types.PointCloud.type = bpy.props.EnumProperty(items=kinds)
door.start_blender()
root = door.import_scene(sys.argv[2])
from feature4x.addon.scene.scene_object import SceneObject
from feature4x.addon.common.point_cloud import read_attribute
from feature4x.f4x_core.geometry import spherical_harmonics
from feature4x.addon.common.gaussian_attributes import draws_splats
from feature4x.f4x_core.scene import read_scene
from feature4x.f4x_core.scene.linear import fitted_look, linear_look
scene = read_scene(sys.argv[2])
assert draws_splats() or sys.argv[3] != "5.3"
look = linear_look(scene) if draws_splats() else fitted_look(scene)
four = "FLOAT4" if bpy.app.version >= (5, 2, 0) else "FLOAT_COLOR"
kinds = {"position": "FLOAT_VECTOR", "scale": "FLOAT_VECTOR", "rotation": "QUATERNION", "radiance:base": four}
seen = 0
for cloud in [each for each in SceneObject(root).clouds if len(each.data.points)]:
    data = cloud.data
    part = scene.dynamic if "dynamic" in cloud.name else scene.static
    rows = slice(len(scene.static), None) if part is scene.dynamic else slice(0, len(scene.static))
    degrees = {f"radiance:sh_{i}": "FLOAT_VECTOR" for i in range(part.sh.shape[1] - 1)}
    found = {name: data.attributes[name].data_type for name in kinds | degrees}
    assert found == kinds | degrees, found
    assert f"radiance:sh_{len(degrees)}" not in data.attributes
    unit = part.quats / np.linalg.norm(part.quats, axis=1, keepdims=True)
    for name, expected in (("scale", look.scales[rows]), ("rotation", unit), ("radiance:base", look.dc[rows])):
        np.testing.assert_allclose(read_attribute(data, name)[:, : expected.shape[1]], expected, atol=1e-6)
    np.testing.assert_array_equal(read_attribute(data, "radiance:base")[:, 3], look.opacities[rows])
    turned = spherical_harmonics.rotate(part.sh, unit)  # from each Gaussian's own frame to the object's
    for i in range(len(degrees)):
        np.testing.assert_allclose(read_attribute(data, f"radiance:sh_{i}"), turned[:, i + 1], atol=1e-5)
    if sys.argv[3] == "5.3":
        assert data.type == "GAUSSIAN_SPLAT", data.type
    seen += len(data.points)
assert seen == len(scene.ids)
print("WHOLE", flush=True)
door.end()
"""


@pytest.mark.parametrize("version", ["present", "5.3"])
def test_clouds_have_the_layout_of_native_splats(tmp_path, version):
    write_scene(random_scene(), tmp_path / "scene.f4x")
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(ROOT), str(tmp_path / "scene.f4x"), version],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        timeout=120,
    )
    assert done.stdout.endswith("WHOLE\n"), done.stdout + done.stderr
