"""Gaussians posed by the core's deformer where geometry nodes are off in the viewport: the same places, whoever moved the nodes."""

import numpy as np
import pytest

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
from feature4x.addon.render import evaluated
from feature4x.addon.rig import native_motion
cloud = next(item for item in root().children if "Feature4X motion" in item.modifiers)
native_motion._is_moving, native_motion._watch = (lambda: True), (lambda: None)  # as during playback, in a window
modifier, reader = cloud.modifiers["Feature4X motion"], evaluated.Reader()

def read(reader):
    bpy.context.view_layer.update()
    found = [each for each in reader.stage(bpy.context.evaluated_depsgraph_get())[0] if each.turn is not None]
    return found[0] if found else None

def both(name):
    for how, on in (("nodes", True), ("core", False)):
        native_motion.switch_on() if on else native_motion.switch_off(cloud)
        assert modifier.show_viewport == on
        found = read(evaluated.Reader())
        for part in ("means", "quats", "turn", "scales", "opacities"):
            arrays[f"{name} {how} {part}"] = getattr(found, part)
        data = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        arrays[f"{name} {how} places"] = native_motion.carried_places(cloud, data)
"""


def test_the_core_poses_as_geometry_nodes_do(folder):
    script = """
from mathutils import Euler, Vector
for frame in (0, 3, 5):
    bpy.context.scene.frame_set(frame); both(f"frame {frame}")
node = next(item for item in bpy.data.objects if item.name.endswith("node 00001"))
node.animation_data_clear()
node.location += Vector((0.1, -0.2, 0.3)); node.rotation_euler = (0.4, 0.1, 0.2); node.scale = (2, 2, 2); both("moved")
root().location, root().scale = (1, 2, 3), (0.5, 0.5, 0.5); both("elsewhere")
ops.query_text(text="square")
half = scene_object().read(".selection") & (np.arange(len(scene_object().shown.scene.ids)) % 2 == 0)
from feature4x.addon.edits import display
display.hide(scene_object(), half); both("half hidden")
"""
    _, arrays = perform(folder, START + script)
    names = {name.removesuffix(" nodes means") for name in arrays if name.endswith(" nodes means")}
    assert len(names) == 6
    for name in names:
        nodes, core = (
            {
                part: arrays[f"{name} {how} {part}"]
                for part in ("means", "quats", "turn", "scales", "opacities", "places")
            }
            for how in ("nodes", "core")
        )
        for part in ("means", "scales", "opacities", "places"):
            np.testing.assert_allclose(core[part], nodes[part], atol=2e-5, err_msg=f"{name} {part}")
        for part in ("quats", "turn"):
            np.testing.assert_allclose(
                np.abs((core[part] * nodes[part]).sum(1)), 1, atol=1e-5, err_msg=f"{name} {part}"
            )
    assert len(arrays["half hidden core means"]) < len(arrays["moved core means"])
    assert np.abs(arrays["moved core means"] - arrays["frame 5 core means"]).max() > 0.05


def test_what_has_not_moved_is_the_very_same_and_deleted_nodes_leave_it_to_geometry_nodes(folder):
    script = """
native_motion.switch_off(cloud)
first, again = read(reader), read(reader)
noted["same"] = [first.means is again.means, first.turn is again.turn]
bpy.context.scene.frame_set(4)
noted["other"] = read(reader).means is first.means
native_motion._may_carry = lambda: False  # another viewport has opened
noted["on"] = modifier.show_viewport, native_motion.look(), modifier.show_viewport
native_motion.switch_off(cloud)
bpy.data.objects.remove(next(item for item in bpy.data.objects if item.name.endswith("node 00001")))
bpy.context.view_layer.update()
native_motion._may_carry = lambda: True
native_motion.look()
noted["without a node"] = modifier.show_viewport
modifier.show_viewport = False
native_motion.look()
native_motion.switch_on()
noted["by hand"] = modifier.show_viewport
"""
    noted, _ = perform(folder, START + script)
    assert noted["same"] == [True, True] and noted["other"] is False
    assert noted["on"] == [False, 0.5, True] and noted["without a node"] is True and noted["by hand"] is False


def test_a_file_that_blender_saved_by_itself_and_copies_are_posed_by_geometry_nodes(folder):
    """An auto-save tells nobody, so it is written while the core poses; so is what a person then copies."""
    script = """
native_motion.switch_off(cloud)
bpy.app.handlers.save_pre.clear()
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "auto.blend"), copy=True)
noted["written"] = modifier.show_viewport
select(cloud)
bpy.ops.object.duplicate()
copy = bpy.context.object
noted["copied"] = copy.modifiers["Feature4X motion"].show_viewport
native_motion.switch_on()
noted["copy"] = copy.modifiers["Feature4X motion"].show_viewport
bpy.ops.wm.open_mainfile(filepath=str(folder / "auto.blend"))
cloud = bpy.data.objects["labelled dynamic"]
noted["opened"] = cloud.modifiers["Feature4X motion"].show_viewport
noted["marked"] = native_motion.CARRIED in cloud
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"written": False, "copied": False, "copy": True, "opened": True, "marked": False}


@pytest.mark.parametrize(
    "gone", ["bpy.data.objects.remove(root())", "bpy.data.collections.remove(root()['f4x_nodes'])"]
)
def test_a_cloud_whose_root_or_nodes_were_deleted_is_left_to_geometry_nodes(folder, gone):
    """Another scene, which is the only one then, does not move it."""
    script = f"""
bpy.context.scene.frame_set(4)
ops.import_scene(filepath=str(folder / "scene.f4x"))
select(bpy.data.objects["labelled"])
native_motion.switch_off(cloud)
read(reader)
{gone}
bpy.context.view_layer.update()
noted["drawn"] = len(read(reader).means)
native_motion._may_carry = lambda: True
native_motion.look()
noted["on"] = modifier.show_viewport
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"drawn": 81, "on": True}


@pytest.mark.parametrize(
    "still", ["_is_moving = lambda: False", "_is_selecting = lambda: True", "_may_carry = lambda: False"]
)
def test_geometry_nodes_pose_whatever_stands_still_or_is_being_selected(folder, still):
    """Blender outlines and picks what they pose."""
    script = f"""
native_motion._may_carry = lambda: True
native_motion.look()
noted["playing"] = modifier.show_viewport
native_motion.{still}
native_motion.look()
noted["still"] = modifier.show_viewport, native_motion.CARRIED in cloud
"""
    noted, _ = perform(folder, START + script)
    assert noted == {"playing": False, "still": [True, False]}
