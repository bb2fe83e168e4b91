"""A scene's floor on Blender's ground and its lengths in meters; clip distances follow."""

from dataclasses import replace

import numpy as np
import pytest
from floater_scenes import planted
from labelled_scene import labelled_scene

from f4x_core.geometry import quaternion
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
def clip():
    depsgraph = bpy.context.evaluated_depsgraph_get()
    data = next(item for item in root().children if item.type == "CAMERA").evaluated_get(depsgraph).data
    return [data.clip_start, data.clip_end]
"""


def test_the_floor_comes_to_lie_on_z_0_and_a_length_becomes_meters(tmp_path):
    scene, _, label = planted("room", 41)
    turn = quaternion.from_rotation_vector(np.array([0.4, 0.1, 0]))
    means = quaternion.rotate(turn, scene.static.means.astype(np.float64)).astype(np.float32)
    export(replace(scene, static=replace(scene.static, means=means)), tmp_path / "a.ply", [0])
    floor = (label == 0) & (np.abs(scene.static.means[:, 1] - 1) < 0.01)
    floor &= (np.abs(scene.static.means[:, 0]) < 1.5) & (scene.static.means[:, 2] < 5)
    script = """
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "a.ply"))
push("imported")
before = np.array(root().matrix_world)
def world():
    means, matrix = scene_object().base.static.means, np.array(root().matrix_world)
    return means @ matrix[:3, :3].T + matrix[:3, 3]
ops.align_floor("EXEC_DEFAULT", True); arrays["aligned"] = world()
bpy.ops.ed.undo()
noted["undone"] = bool((np.array(root().matrix_world) == before).all())
places = world()[np.load(folder / "floor.npy")]
far = [int(np.argmax(places @ way)) for way in ((1, -1, 0), (-1, -1, 0), (0, 1, 0))]
ops.align_points("EXEC_DEFAULT", True, a=places[far[0]], b=places[far[1]], c=places[far[2]])
arrays["by points"] = world()
noted["line"] = refused(ops.align_points, a=(0, 0, 0), b=(1, 0, 0), c=(2, 0, 0))
clips = clip()
a, b = (world()[np.load(folder / "floor.npy")][i] for i in far[:2])
ops.scale_length("EXEC_DEFAULT", True, a=a, b=b, length=50 * float(np.linalg.norm(b - a)))
arrays["scaled"] = world()
noted["clip"] = [after / first for first, after in zip(clips, clip())]
root().scale *= 2; bpy.context.view_layer.update()
noted["by hand"] = clip()[1] / clips[1]
noted["same"] = refused(ops.scale_length, a=(1, 1, 1), b=(1, 1, 1))
noted["stack"] = len(scene_object().stack)
root().keyframe_insert("location")
noted["keyed"] = refused(ops.align_floor)
"""
    np.save(tmp_path / "floor.npy", np.flatnonzero(floor))
    noted, arrays = perform(tmp_path, START + script)
    for name in ("aligned", "by points"):
        height = arrays[name][:, 2]
        assert np.abs(height[floor]).max() < 0.03 and np.median(height) > 0, name
    assert np.abs(arrays["scaled"][floor, 2]).max() < 1.5
    assert np.ptp(arrays["scaled"], axis=0) == pytest.approx(50 * np.ptp(arrays["by points"], axis=0), rel=1e-3)
    assert noted["clip"] == pytest.approx([50, 50]) and noted["by hand"] == pytest.approx(100)
    assert noted["undone"] and "nearly on one line" in noted["line"] and "the same" in noted["same"]
    assert noted["stack"] == 0 and "has keys" in noted["keyed"]


def test_exports_stand_where_the_scene_was_placed(folder):
    before = (folder / "scene.f4x").read_bytes()
    script = """
ops.import_scene(filepath=str(folder / "scene.f4x"))
ops.export_scene(filepath=str(folder / "as_it_came.ply"))
root().scale *= 10
root().location = (1, 2, 3)
ops.export_scene(filepath=str(folder / "placed.ply"))
ops.export_scene(filepath=str(folder / "file.ply"), as_placed=False)
root().scale.x *= 2
noted["uneven"] = refused(ops.export_scene, filepath=str(folder / "uneven.ply"))
"""
    noted, _ = perform(folder, START + script)
    came, placed, file = (open_any(folder / f"{name}.ply").static for name in ("as_it_came", "placed", "file"))
    means = read_scene(folder / "scene.f4x").posed(0).means
    np.testing.assert_array_equal(came.means, means)
    np.testing.assert_array_equal(file.means, means)
    np.testing.assert_allclose(placed.means, 10 * means + (1, -3, 2), atol=1e-5)  # Blender's axes are x, z, -y
    np.testing.assert_allclose(placed.scales, 10 * came.scales, rtol=1e-5)
    assert "scale" in noted["uneven"] and not (folder / "uneven.ply").exists()
    assert (folder / "scene.f4x").read_bytes() == before


def test_moves_are_along_blenders_axes_wherever_the_scene_was_placed(tmp_path):
    script = """
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
ops.add_crop_box()
box = bpy.context.object
root().rotation_euler = (2.5, 0.3, 0.4)  # of a clip whose camera looked down
bpy.context.view_layer.update()
ops.scale_length(a=(0, 0, 0), b=(1, 0, 0), length=3)
bpy.context.view_layer.update()
noted["meters"] = scene_object().meters
ops.plan(sentence="move what moves up by 30 cm")
noted["planned"] = json.loads(root().f4x.readings[0].operations)[0]["translate"]
ops.drop_plan()
noted["box"] = float(np.abs(np.array(box.matrix_world) - np.array(box.matrix_basis)).max())
ops.plan(sentence="select what moves")
chosen = np.flatnonzero(scene_object().read(".selection"))

def middle():
    means, matrix = scene_object().shown.scene.posed(0.0).means, np.array(root().matrix_world)
    return np.median(means[chosen] @ matrix[:3, :3].T + matrix[:3, 3], axis=0)

before = middle()
ops.transform(move=(0, 0, 1))
noted["moved"] = (middle() - before).tolist()
noted["row"], field = root().f4x.history[0].name, root().f4x.fields.transform
noted["field"] = list(field.translate)
field.translate = (2, 0, 0)
noted["set"] = (middle() - before).tolist()
field.translate, field.rotate = (0, 0, 0), (0, 0, 0.5)
turn = np.array(scene_object().axes.turn_in_world(scene_object().stack.edits[0].operation.rotate))
noted["turned"] = np.deg2rad(turn).tolist()
field.rotate = (0, 0, 0)
ops.edit_gizmo(edit_id=root().f4x.history[0].edit_id)
handle = bpy.context.object
handle.location = (0, 1, 0)
bpy.context.view_layer.update()
noted["dragged"] = (middle() - before).tolist()
noted["on the thing"] = (middle() - np.array(handle.matrix_world.translation)).tolist()
select(root())
root().rotation_euler = (0, 0, 0)
bpy.context.view_layer.update()
noted["axes"] = [list(handle.location), list(field.translate), root().f4x.history[0].name]
noted["stack"] = len(scene_object().stack)
"""
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    noted, _ = perform(tmp_path, START + script)
    assert [noted["moved"], noted["field"]] == [pytest.approx([0, 0, 1], abs=1e-4)] * 2
    assert noted["meters"] == pytest.approx(3) and np.linalg.norm(noted["planned"]) == pytest.approx(0.1, abs=1e-4)
    assert noted["row"] == "move what moves by (0, 0, 1) units along Blender's X, Y and Z"
    assert noted["set"] == pytest.approx([2, 0, 0], abs=1e-4) and noted["turned"] == pytest.approx(
        [0, 0, 0.5], abs=1e-4
    )
    assert noted["dragged"] == pytest.approx([0, 1, 0], abs=1e-4)
    assert noted["on the thing"] == pytest.approx([0, 0, 0], abs=1e-4) and noted["box"] < 1e-4
    location, field, row = noted["axes"]
    assert location == pytest.approx(field, abs=1e-4) and np.linalg.norm(field) == pytest.approx(1, abs=1e-3)
    assert f"({field[0]:.3g}, " in row and noted["stack"] == 1
