"""Nodes that are renamed, copied or deleted: points know them by their stored ids, and nothing else comes apart."""

import numpy as np
import pytest

from .artist import perform
from .tiny_scene import NODES, tiny_scene

START = """
from feature4x.addon.rig.scaffold import layer_of
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
bpy.context.scene.frame_set(4)
show_nodes()
push("imported")
cloud, first = bpy.data.objects["tiny dynamic"], root()

def note(name):
    bpy.context.view_layer.update()
    arrays[name] = values(bpy.data.objects["tiny dynamic"])
    noted[name] = bpy.data.objects["tiny"].f4x.notice

def node(index):
    return bpy.data.objects[f"tiny node {index:05d}"]

note("before")
"""


NAMES = (
    "Head",
    "zzz",
    "tiny node 7",
    "0",
    "Änne",
    "tiny node 00004.5",
    "TINY NODE 00002b",
    ".dot",
    "tiny node 2",
    "日本",
)


def test_renamed_nodes_keep_their_points(tiny_folder):
    script = f"""
for number, name in enumerate({NAMES}):
    node(number).name = name
    note("name %d" % number)
node({NODES - 1}).location.x += 0.4
note("moved")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
bpy.context.scene.frame_set(4)
note("opened")
select(bpy.data.objects["Head"])
noted["written"] = list(ops.write_motion())
"""
    noted, arrays = perform(tiny_folder, START + script)
    for number in range(len(NAMES)):
        np.testing.assert_allclose(arrays[f"name {number}"], arrays["before"], atol=1e-6)
    follows = (tiny_scene().dynamic.node == NODES - 1).any(1)
    assert np.abs(arrays["moved"] - arrays["before"])[follows].max() > 0.05
    np.testing.assert_allclose(arrays["moved"][~follows], arrays["before"][~follows], atol=1e-6)
    np.testing.assert_allclose(arrays["opened"], arrays["before"], atol=1e-6)  # the move had no key
    assert noted["written"] == ["FINISHED"] and noted["name 9"] == ""


def test_a_move_without_a_key_is_written_back_at_its_frame(tiny_folder):
    script = """
select(node(3))
node(3).location.x += 0.4
note("moved")
noted["written"] = list(ops.write_motion())
note("after")
bpy.context.scene.frame_set(3); note("earlier")
bpy.context.scene.frame_set(4); note("again")
[rekey] = [edit.operation for edit in scene_object().stack.edits]
noted["nodes"], noted["times"] = len(rekey.nodes), len(rekey.times)
"""
    noted, arrays = perform(tiny_folder, START + script)
    assert np.abs(arrays["moved"] - arrays["before"]).max() > 0.05
    np.testing.assert_allclose(arrays["after"], arrays["moved"], atol=1e-6)
    np.testing.assert_allclose(arrays["again"], arrays["moved"], atol=1e-6)
    assert np.abs(arrays["earlier"] - arrays["moved"]).max() > 0.05
    assert (noted["written"], noted["nodes"], noted["times"]) == (["FINISHED"], 1, 1)


def test_a_copied_node_carries_nothing(tiny_folder):
    script = """
select(node(3))
bpy.ops.object.duplicate()
copy = bpy.context.object
note("copied")
copy.animation_data_clear(); copy.location.x += 5
note("moved")
noted["name"], noted["is node"] = copy.name, "f4x_node" in copy
node(3).animation_data_clear(); node(3).location.x += 0.4
note("original")
noted["written"] = list(ops.write_motion())
noted["stack"] = len(scene_object().stack)
"""
    noted, arrays = perform(tiny_folder, START + script)
    np.testing.assert_allclose(arrays["copied"], arrays["before"], atol=1e-6)
    np.testing.assert_allclose(arrays["moved"], arrays["before"], atol=1e-6)
    assert np.abs(arrays["original"] - arrays["before"]).max() > 0.05
    assert not noted["is node"] and noted["copied"] == "tiny node 00003.001 is a copy of a node; no points follow it."
    assert noted["written"] == ["FINISHED"] and noted["stack"] == 1


def test_deleted_nodes_leave_their_points_with_the_others(tiny_folder):
    script = """
select(node(3)); push("selected")
bpy.ops.object.delete(); push("deleted")
note("one gone")
select(*[node(index) for index in range(12) if index not in (3, 5)]); push("selected")
bpy.ops.object.delete(); push("deleted")
note("one left")
select(node(5)); noted["written"] = refused(ops.write_motion)
bpy.ops.ed.undo(); bpy.ops.ed.undo(); bpy.ops.ed.undo(); bpy.ops.ed.undo()
bpy.context.scene.frame_set(4)
note("undone")
"""
    noted, arrays = perform(tiny_folder, START + script)
    scene = tiny_scene()
    follows = (scene.dynamic.node == 3).any(1)
    np.testing.assert_allclose(arrays["one gone"][~follows], arrays["before"][~follows], atol=1e-6)
    # nodes of the scene spin by themselves, so that a neighbour's motion is another one, but no Gaussian flies away
    reach = np.abs(arrays["before"]).max()
    assert follows.any() and np.abs(arrays["one gone"]).max() < 2 * reach
    assert np.isfinite(arrays["one left"]).all() and np.abs(arrays["one left"]).max() < 4 * reach
    np.testing.assert_allclose(arrays["undone"], arrays["before"], atol=1e-6)
    assert noted["one gone"] == "1 node is missing; its points follow the nodes around it. Ctrl-Z brings it back."
    assert noted["one left"].startswith("11 nodes are missing; their points follow") and noted["undone"] == ""
    assert "nodes are missing" in noted["written"] and "Traceback" not in noted["written"]


HIERARCHY = """
layer_of(first).hide_viewport = {hidden}
bpy.context.view_layer.update()
select(first, *first.children_recursive)
noted["nodes visible"] = node(3).visible_get()
bpy.context.view_layer.objects.active = first
bpy.ops.object.{how}()
copy = bpy.context.object
note("copied")
twin = next(item for item in copy.children if item.name.startswith("tiny dynamic"))
arrays["twin"] = values(twin)
noted["root"] = SceneObject.of(twin).name
copy.location.x += 3
bpy.context.view_layer.update()
arrays["twin moved"] = values(twin)
moved = next(item for item in copy.children if item.name == "tiny node 00003.001")
moved.animation_data_clear(); moved.location.x += 0.4
note("node of the copy")
arrays["twin changed"] = values(twin)
select(twin)
noted["written"] = list(ops.write_motion())
noted["stacks"] = [len(SceneObject(item).stack) for item in (first, copy)]
ops.change_selection(how="ALL")
ops.recolour(rgb=(0, 1, 0), shading=False)
arrays["colour"], arrays["twin colour"] = values(bpy.data.objects["tiny dynamic"], "rgb"), values(twin, "rgb")
bpy.data.objects.remove(node(3))
bpy.context.view_layer.update()
arrays["twin alone"] = values(twin)
noted["selected"] = [item.f4x.selected for item in (first, copy)]
"""


@pytest.mark.parametrize("how", ["duplicate", "duplicate_move_linked"])
@pytest.mark.parametrize("hidden", [False, True])
def test_a_copied_scene_is_a_second_scene(tiny_folder, how, hidden):
    noted, arrays = perform(tiny_folder, START + HIERARCHY.format(how=how, hidden=hidden))
    assert noted["nodes visible"] != hidden
    for name in ("copied", "node of the copy"):
        np.testing.assert_allclose(arrays[name], arrays["before"], atol=1e-6)
    for name in ("twin", "twin moved"):
        np.testing.assert_allclose(arrays[name], arrays["before"], atol=1e-6)
    assert np.abs(arrays["twin changed"] - arrays["before"]).max() > 0.05
    assert noted["root"] == "tiny.001" and noted["stacks"] == [0, 1]
    assert noted["copied"] == "" and noted["selected"][0] == 0 < noted["selected"][1]
    assert np.ptp(arrays["twin colour"][:, :3], axis=0).max() < 1e-6 < np.ptp(arrays["colour"][:, :3], axis=0).max()
    np.testing.assert_allclose(arrays["twin alone"], arrays["twin changed"], atol=1e-6)


def test_a_copied_root_alone_is_an_empty(tiny_folder):
    script = """
select(first)
bpy.ops.object.duplicate()
copy = bpy.context.object
note("copied")
noted["keys"] = [key for key in copy.keys() if key != "f4x"]
"""
    noted, arrays = perform(tiny_folder, START + script)
    np.testing.assert_allclose(arrays["copied"], arrays["before"], atol=1e-6)
    assert noted["keys"] == []


def test_a_copied_scene_with_handles_follows_the_nodes_of_its_original(tiny_folder):
    script = """
ops.add_handles(count=2)
note("handles")
select(first, *first.children_recursive)
bpy.context.view_layer.objects.active = first
bpy.ops.object.duplicate()
note("copied")
twin = next(item for item in bpy.context.object.children if item.name.startswith("tiny dynamic"))
arrays["twin"] = values(twin)
bpy.data.objects["tiny handle 00"].location.x += 0.3
note("moved")
arrays["twin moved"] = values(twin)
"""
    _, arrays = perform(tiny_folder, START + script)
    for name in ("handles", "copied", "twin"):
        np.testing.assert_allclose(arrays[name], arrays["before"], atol=1e-5)
    assert np.abs(arrays["moved"] - arrays["before"]).max() > 0.05
    np.testing.assert_array_equal(arrays["twin moved"], arrays["moved"])


@pytest.mark.parametrize("how", ["append", "link"])
def test_nodes_of_a_scene_from_another_file_are_hidden(tiny_folder, how):
    script = f"""
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "lib.blend"))
bpy.ops.wm.read_factory_settings(use_empty=True)
options = {{}} if {how!r} == "append" else {{"instance_collections": False}}
bpy.ops.wm.{how}(directory=str(folder / "lib.blend" / "Collection") + "/", filename="tiny", **options)
(there,) = [item for item in bpy.context.scene.objects if "f4x_path" in item]
noted["hidden"], noted["nodes"] = layer_of(there).hide_viewport, len(layer_of(there).collection.objects)
arrays["appended"] = values(bpy.data.objects["tiny dynamic"])
"""
    noted, arrays = perform(tiny_folder, START + script)
    assert noted["hidden"] and noted["nodes"] == NODES
    assert len(arrays["appended"]) == len(arrays["before"])
