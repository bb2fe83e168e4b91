"""Faults that a random walk over the extension found (`tools/walk_blender.py`), each as a short script, and a short walk."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.formats import export

from .artist import perform

REPOSITORY = Path(__file__).resolve().parents[2]

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
push("imported")

def by_name(name):
    return SceneObject(bpy.data.objects[name])
"""


def walk(folder: Path, seed: int, steps: int) -> dict:
    """The result of a walk."""
    command = [sys.executable, str(REPOSITORY / "tools/walk_blender.py"), str(folder / "scene.f4x")]
    command += ["--out", str(folder / "walk"), "--seed", str(seed), "--steps", str(steps)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    assert done.returncode == 0, (folder / "walk/steps.txt").read_text()[-3000:] + done.stdout[-3000:]
    return json.loads((folder / "walk/result.json").read_text())


def test_a_short_walk_finds_nothing_wrong(folder):
    found = walk(folder, 1, 200)
    assert found["steps"] == 200 and len(found["memory"]) == 3 and not found["wrong"]
    assert sum(count for name, count in found["tally"].items() if name.endswith("done")) > 30


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 10, 14])
def test_a_walk_of_minutes_finds_nothing_wrong_and_keeps_its_memory(folder, seed):
    assert walk(folder, seed, 1500)["steps"] == 1500


def test_ctrl_z_after_a_plan_that_copies_does_not_end_blender(folder):
    script = """
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.recolour("EXEC_DEFAULT", True, rgb=(1, 0, 0))
ops.plan("EXEC_DEFAULT", True, sentence="copy the wall to the left")
noted["planned"], noted["resizes"] = len(scene_object().clouds), "resize" in bpy.types.PointCloud.bl_rna.functions
bpy.ops.ed.undo(); bpy.context.view_layer.update()
noted["undone"] = [len(scene_object().stack), len(root().f4x.readings), "f4x_preview" in root(), root().f4x.sentence]
shown = [values(cloud, "gid") for cloud in scene_object().clouds]
noted["shown"] = sum(len(ids) for ids in shown if ids is not None)
bpy.ops.ed.redo(); bpy.context.view_layer.update()
noted["redone"] = [len(scene_object().stack), len(root().f4x.readings)]
"""
    noted, _ = perform(folder, START + script)
    steps = 0 if noted["resizes"] else 1  # before 5.1 the copy is another datablock, of which undo must know
    assert noted["planned"] == 3 and noted["shown"] == 1201
    assert noted["undone"] == [steps, 0, False, "copy the wall to the left"] and noted["redone"] == [1, 0]


def test_a_blend_of_an_older_version_gets_what_a_plan_needs_as_a_step_of_its_own(folder):
    script = """
for cloud in scene_object().clouds:
    if "edited" in cloud.name:
        bpy.data.objects.remove(cloud)
    elif "Feature4X visible" in cloud.modifiers:
        cloud.modifiers.remove(cloud.modifiers["Feature4X visible"])
push("older")
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.plan("EXEC_DEFAULT", True, sentence="copy the wall to the left")
noted["planned"] = [len(scene_object().clouds), "f4x_preview" in root()]
for step in ("undo", "undo", "redo", "redo"):
    getattr(bpy.ops.ed, step)(); bpy.context.view_layer.update()
    noted.setdefault("steps", []).append([len(scene_object().stack), len(root().f4x.readings), "f4x_preview" in root()])
ops.plan("EXEC_DEFAULT", True, sentence="copy the wall to the left")
ops.apply_plan("EXEC_DEFAULT", True)
bpy.ops.ed.undo(); bpy.context.view_layer.update()
shown = [values(cloud, "gid") for cloud in scene_object().clouds]
noted["shown"] = [len(scene_object().stack), sum(len(ids) for ids in shown if ids is not None)]
"""
    noted, _ = perform(folder, START + script)
    assert noted["planned"] == [3, True] and noted["shown"] == [0, 1201]
    assert noted["steps"] == 4 * [[0, 0, False]]


def test_undo_shows_edits_over_time_as_they_are_at_this_frame(folder):
    script = """
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.transform("EXEC_DEFAULT", True, move=(0, 0, 1), over_time=True, first=0, last=5)
ops.change_selection("EXEC_DEFAULT", True, how="NONE")
ops.change_selection("EXEC_DEFAULT", True, how="ALL")
bpy.context.scene.frame_set(4)
bpy.ops.ed.undo()
noted["frame"] = bpy.context.scene.frame_current
found = scene_object()
arrays["there"] = read_attribute(found.clouds[-1].data, "position")
arrays["core"] = found.shown.moment(found.frame).means
"""
    noted, arrays = perform(folder, START + script)
    assert noted["frame"] == 4
    np.testing.assert_allclose(arrays["there"], arrays["core"], atol=1e-5)


def test_undo_after_a_preview_ended_shows_what_the_scene_holds(folder):
    """Undo brings back points that an artist has changed in between, as they were in the preview; and not the root."""
    script = """
from feature4x.addon.edits import fields
from feature4x.addon.common.point_cloud import write_attribute
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.plan("EXEC_DEFAULT", True, sentence="make it half transparent")
push("anything")
for cloud in scene_object().clouds:
    write_attribute(cloud.data, ".selection", "BOOLEAN", np.ones(len(cloud.data.points), bool))
push("select points in Edit Mode")
ops.apply_plan("EXEC_DEFAULT", True)
for name in ("applied", "selected"):
    bpy.ops.ed.undo(); bpy.context.view_layer.update()
    fields.show_late()  # in a window a timer calls it
    found, parts = scene_object(), list(scene_object().points())
    arrays[f"{name} there"] = np.concatenate([read_attribute(cloud.data, "radiance:base")[at, 3] for cloud, at, _ in parts])
    arrays[f"{name} core"] = found.shown.appearance(found.frame).opacities[np.concatenate([row for *_, row in parts])]
"""
    _, arrays = perform(folder, START + script)
    for name in ("applied", "selected"):
        np.testing.assert_allclose(arrays[f"{name} there"], arrays[f"{name} core"], atol=1e-5)


def test_undo_shows_a_dragged_edit_over_time_in_the_list(folder):
    """In a window a drag is shown after its step of undo; undo draws what changes over time, and the list waits for a timer."""
    script = """
from dataclasses import replace
from feature4x.addon.edits import fields, listing
from feature4x.addon.scene import cache
from feature4x.addon.scene.scene_object import EDITS
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.transform("EXEC_DEFAULT", True, move=(0, 0, 1), over_time=True, first=0, last=5)
stack = scene_object().stack
dragged = stack.replace(1, replace(stack.edits[0].operation, translate=(0.5, 0.0, 0.0)))
root()[EDITS] = cache.text_of(dragged)
push("dragged")
fields.show_late()
ops.query_text("EXEC_DEFAULT", True, text="wall")
bpy.ops.ed.undo(); bpy.context.view_layer.update()
fields.show_late()
noted["shown"] = [row.name for row in scene_object().state.history]
noted["held"] = [listing.words_of(edit.operation, scene_object().axes) for edit in scene_object().stack.edits]
"""
    noted, _ = perform(folder, START + script)
    assert noted["shown"] == noted["held"] and "0.5" in noted["held"][0]


def test_undo_of_what_a_button_did_in_edit_mode_brings_all_clouds_back(folder):
    """Steps of undo of Edit Mode hold the points of the edited cloud alone."""
    script = """
ops.query_text("EXEC_DEFAULT", True, text="square")
select(scene_object().clouds[0])
push("picked")
bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode="EDIT")
noted["in"] = bpy.context.mode
for name in ("before", "after"):
    for at, cloud in enumerate(scene_object().clouds[:2]):
        arrays[f"{at} {name}"] = read_attribute(cloud.data, ".selection")
    if name == "before":
        ops.change_selection("EXEC_DEFAULT", True, how="ALL")
        bpy.ops.ed.undo()
"""
    noted, arrays = perform(folder, START + script)
    assert noted["in"] != "OBJECT" and len(arrays) == 4
    for at in range(2):
        np.testing.assert_array_equal(arrays[f"{at} after"], arrays[f"{at} before"])


def test_undo_of_copied_nodes_lets_points_follow_their_own_nodes(folder):
    """Places of nodes are worked out after the step of undo that copies them, so undo finds the same mesh in both steps."""
    script = """
from feature4x.addon.rig.scaffold import layer_of
ops.add_handles("EXEC_DEFAULT", True, count=1)
layer_of(root()).hide_viewport = False
push("shown")
select(root(), *root().children_recursive)
push("select")
bpy.context.scene.frame_set(1)
bpy.ops.object.duplicate("EXEC_DEFAULT", True, linked=True)
bpy.context.view_layer.update()
ops.query_text("EXEC_DEFAULT", True, text="wall")
bpy.ops.ed.undo(); bpy.ops.ed.undo(); bpy.context.view_layer.update()
found = by_name("labelled")
noted["objects"] = [item.name for item in bpy.context.scene.objects if "." in item.name]
arrays["there"] = values(next(item for item in found.clouds if "dynamic" in item.name))
arrays["core"] = found.shown.scene.posed(found.frame).means[len(found.base.static):]
"""
    noted, arrays = perform(folder, START + script)
    assert not noted["objects"]
    np.testing.assert_allclose(arrays["there"], arrays["core"], atol=1e-4)


def test_undo_of_another_start_frame_puts_keys_back(folder):
    """The custom property is changed, not the field of the sidebar, so a handler moves the keys after the step of undo."""
    script = """
class StartLater(bpy.types.Operator):
    bl_idname, bl_label, bl_options = "object.start_later", "Start Later", {"UNDO"}

    def execute(self, context):
        context.object["f4x_start"] = 2.0
        context.object.update_tag()
        return {"FINISHED"}

bpy.utils.register_class(StartLater)
select(root())
push("before")
bpy.ops.object.start_later("EXEC_DEFAULT", True)
for name in ("set", "undone", "redone", "undone again"):
    if name != "set":
        (bpy.ops.ed.redo if name == "redone" else bpy.ops.ed.undo)()
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(3)
    node = bpy.data.objects["labelled node 00000"]
    noted[name] = [root()["f4x_start"], round(node.matrix_local.translation.x, 3)]
"""
    noted, _ = perform(folder, START + script)
    first = -0.32
    later, at_first = [2.0, round(first + 0.05, 3)], [0.0, round(first + 3 * 0.05, 3)]
    assert noted == {"set": later, "undone": at_first, "redone": later, "undone again": at_first}


def test_the_walk_compares_no_points_between_nodes_half_a_turn_apart(folder):
    """The signs of such nodes decide, which Blender's objects do not have; all other points are compared."""
    scene = labelled_scene()
    quat = scene.scaffold.quat.copy()
    quat[1:, 1] = (0, 0, 0, -1)
    scene = replace(scene, scaffold=replace(scene.scaffold, quat=quat))
    write_scene(scene, folder / "scene.f4x")
    script = """
import walk_checks
bpy.context.scene.frame_set(3)
found = scene_object()
noted["undecided"] = int(walk_checks.undecided(found.shown.scene, 3.0).sum())
walk_checks.check_points(found)
walk_checks.undecided = lambda scene, frame: np.zeros(len(scene.ids), bool)
try:
    walk_checks.check_points(found)
except walk_checks.WrongError as error:
    noted["compared"] = str(error)
"""
    noted, _ = perform(folder, START + script)
    assert noted["undecided"] == len(scene.dynamic) and "points stand" in noted["compared"]


def test_a_slider_without_the_scene_file_says_so(folder):
    script = """
(folder / "scene.f4x").rename(folder / "away.f4x")
root().f4x.sphere_radius = 0.3
noted["answer"] = root().f4x.answer
"""
    noted, _ = perform(folder, START + script)
    assert "scene.f4x cannot be read" in noted["answer"]


@pytest.mark.parametrize(
    "change",
    ['(folder / "scene.f4x").rename(folder / "away.f4x")', "bpy.context.object.parent = scene_object().clouds[0]"],
)
def test_a_handle_without_its_scene_stays_where_it_is(folder, change):
    script = f"""
ops.query_text("EXEC_DEFAULT", True, text="square")
ops.edit_gizmo("EXEC_DEFAULT", True, edit_id=0)
handle = bpy.context.object
noted["before"] = list(handle.delta_location)
{change}
from feature4x.addon.operators import handles
handles._frame_changed(bpy.context.scene)
noted["after"] = list(handle.delta_location)
"""
    noted, _ = perform(folder, START + script)
    assert noted["after"] == noted["before"]


@pytest.mark.parametrize(
    "before",
    [
        'bpy.context.scene.render.engine = "BLENDER_WORKBENCH"',
        """
item = bpy.data.objects.new("gone", None)
bpy.context.scene.collection.objects.link(item)
select(item)
bpy.data.objects.remove(item)""",
    ],
    ids=["while Workbench is the engine", "where something selected has just been removed"],
)
def test_importing(folder, before):
    script = f"""
{before}
ops.import_scene(filepath=str(folder / "scene.f4x"), set_up_render={"WORKBENCH" not in before})
noted["scenes"] = len(SceneObject.among(bpy.data.objects))
"""
    noted, _ = perform(folder, START + script)
    assert noted["scenes"] == 2


def test_a_scene_that_hangs_below_another_keeps_its_own_points(folder):
    script = """
ops.import_scene(filepath=str(folder / "scene.f4x"))
bpy.data.objects["labelled (2)"].parent = bpy.data.objects["labelled"]
select(bpy.data.objects["labelled"])
ops.query_text(text="square")
noted["clouds"] = [sum(len(cloud.data.points) > 0 for cloud in by_name(name).clouds) for name in ("labelled", "labelled (2)")]
noted["selected"] = [int(by_name(name).read(".selection").sum()) for name in ("labelled", "labelled (2)")]
"""
    noted, _ = perform(folder, START + script)
    assert noted["clouds"] == [2, 2] and noted["selected"] == [81, 0]


def test_copies_of_a_scene_are_edited_alone(folder):
    """A linked copy, also of a scene with handles, and a copy of the whole Blender scene, which moves by its own nodes."""
    script = """
ops.add_handles(count=1)
select(root(), *root().children_recursive)
bpy.ops.object.duplicate(linked=True)
bpy.context.view_layer.update()
names = ("labelled", "labelled.001")
noted["shared"] = len({cloud.data.name for name in names for cloud in by_name(name).clouds if len(cloud.data.points)})
select(bpy.data.objects["labelled.001"])
ops.query_text(text="square")
noted["selected"] = [int(by_name(name).read(".selection").sum()) for name in names]
"""
    noted, _ = perform(folder, START + script)
    assert noted["shared"] == 4 and noted["selected"] == [0, 81]
    script = """
bpy.ops.scene.new(type="FULL_COPY")
bpy.context.view_layer.update()
copy = SceneObject.among(bpy.context.scene.objects)[0]
copy.root.location.x += 1
bpy.context.view_layer.update()
cloud = next(item for item in copy.clouds if "dynamic" in item.name)
arrays["there"], arrays["core"] = values(cloud), copy.shown.scene.posed(0.0).means[len(copy.base.static):]
"""
    _, arrays = perform(folder, START + script)
    np.testing.assert_allclose(arrays["there"], arrays["core"], atol=1e-4)


def test_nodes_of_another_scene_below_one_without_nodes_are_not_its_own(folder):
    export(read_scene(folder / "scene.f4x"), folder / "splats.ply", [0.0])
    script = """
from feature4x.addon.rig.motion_edits import unwritten
ops.import_scene(filepath=str(folder / "splats.ply"))
node, splats = bpy.data.objects["labelled node 00001"], bpy.data.objects["splats"]
node.parent = splats
select(node)
noted["unwritten"] = unwritten(SceneObject(splats))
noted["said"] = refused(ops.grab_nodes, offset=(0.1, 0, 0))
"""
    noted, _ = perform(folder, START + script)
    assert noted["unwritten"] == 0 and "with moving objects" in noted["said"]


def test_copies_of_nodes_take_no_more_than_the_nodes(folder):
    """Blender copies the keys with each object: all keys were copied once for each node."""
    script = """
def keys():
    return sum(len(curve.keyframe_points) for action in bpy.data.actions for layer in action.layers
               for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves)

noted["keys"] = [keys()]
bpy.ops.scene.new(type="FULL_COPY")
noted["keys"].append(keys())
"""
    noted, _ = perform(folder, START + script)
    once, twice = noted["keys"]
    assert twice == 2 * once


def test_nodes_of_another_scene_cannot_be_grabbed(folder):
    script = """
ops.import_scene(filepath=str(folder / "scene.f4x"))
from feature4x.addon.rig.scaffold import layer_of
for name in ("labelled", "labelled (2)"):
    layer_of(bpy.data.objects[name]).hide_viewport = False
select(bpy.data.objects["labelled"], bpy.data.objects["labelled (2) node 00001"])
noted["said"] = refused(ops.grab_nodes, offset=(0.1, 0, 0))
"""
    noted, _ = perform(folder, START + script)
    assert "not those of labelled" in noted["said"] and "Traceback" not in noted["said"]


def test_the_sidebar_counts_what_is_there(folder):
    script = """
from feature4x.addon.edits import listing
ops.change_selection(how="ALL")
before = listing.counts(scene_object())
bpy.data.objects.remove(bpy.data.objects["labelled dynamic"])
noted["counts"] = [*before, *listing.counts(scene_object())]
"""
    noted, _ = perform(folder, START + script)
    assert noted["counts"] == [1201, 1201, 1120, 1120]


def test_the_sidebar_counts_anew_after_every_change_and_only_then(folder):
    script = """
from feature4x.addon.edits import listing
calls, count = [], listing.counts
listing.counts = lambda found: calls.append(1) or count(found)

def seen(name):
    bpy.context.view_layer.update()  # as before each redraw
    calls.clear()
    noted[name] = [*listing.last_counts(scene_object()), *listing.last_counts(scene_object()), len(calls)]

seen("imported")
ops.change_selection("EXEC_DEFAULT", True, how="ALL"); seen("all")
noted["asked again"] = [*listing.last_counts(scene_object()), len(calls)]
ops.query_text("EXEC_DEFAULT", True, text="square"); seen("square")
ops.remove("EXEC_DEFAULT", True); seen("removed")
bpy.ops.ed.undo(); seen("undone")
bpy.ops.ed.redo(); seen("redone")
bpy.ops.ed.undo()
ops.transform("EXEC_DEFAULT", True, move=(0, 0, 1))
scene_object().state.use_span, scene_object().state.first, scene_object().state.last = True, 2, 3
ops.remove("EXEC_DEFAULT", True); seen("removed for a while")
bpy.context.scene.frame_set(2); seen("in that while")
bpy.data.objects.remove(bpy.data.objects["labelled static"]); seen("without the wall")
"""
    noted, _ = perform(folder, START + script)
    assert noted.pop("asked again") == [1201, 1201, 1]
    assert noted == {
        name: [*two, *two, 1]
        for name, two in {
            "imported": (0, 1201),
            "all": (1201, 1201),
            "square": (81, 1201),
            "removed": (0, 1120),
            "undone": (81, 1201),
            "redone": (0, 1120),
            "removed for a while": (81, 1201),
            "in that while": (0, 1120),
            "without the wall": (0, 0),
        }.items()
    }


def test_a_node_without_a_parent_takes_a_written_motion_back(folder):
    """An artist cleared its parent, or deleted the handle that it hung from."""
    script = """
from feature4x.addon.rig.scaffold import NODE, read_poses, write_poses
node = next(item for item in bpy.data.objects if item.get(NODE) == 0)
frames = np.arange(6.0)
arrays["before"] = read_poses(root(), [node], frames)[0]
world = node.matrix_world.copy()
node.parent = None
node.matrix_world = world
xyz, quat = read_poses(root(), [node], frames)
write_poses(root(), [node], frames, arrays["before"] + 0.1, quat)
arrays["after"] = read_poses(root(), [node], frames)[0]
"""
    _, arrays = perform(folder, START + script)
    np.testing.assert_allclose(arrays["after"], arrays["before"] + 0.1, atol=1e-5)
