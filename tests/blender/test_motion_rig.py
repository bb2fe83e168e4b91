"""The rig in Blender: nodes grabbed softly, handles, and motion written back as an edit that the core poses alike."""

import numpy as np
import pytest

from f4x_core.edit.apply import open_scene
from f4x_core.edit.stack import read_stack
from f4x_core.scene import write_scene

from .artist import perform
from .tiny_scene import CLIP, tiny_scene

# What the child does: an artist's session, step by step. After each it notes where the points are and copies the file.
CHILD = """
import shutil
from feature4x.addon.edits import display
from feature4x.addon.rig import scaffold
from feature4x.addon.io.import_scene import import_scene
clip = int(sys.argv[3])
bpy.ops.wm.read_factory_settings(use_empty=True)
file = folder / "tiny.f4x"
root = import_scene(file)
scaffold.layer_of(root).hide_viewport = False
scene = bpy.context.scene

def note(label):
    for frame in range(clip):
        scene.frame_set(frame)
        arrays[f"{label}/{frame}"] = values(bpy.data.objects["tiny dynamic"])
    shutil.copy(file, folder / f"{label}.f4x")

def node(index):
    return bpy.data.objects[f"tiny node {index:05d}"]

graph = bpy.data.objects["tiny graph"]
noted["graph hidden"] = [graph.hide_viewport, graph.hide_render]
graph.hide_viewport = False
scene.frame_set(4)
arrays["graph"] = np.array([v.co for v in graph.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices])
graph.hide_viewport = True
select(node(3))
bpy.ops.f4x.write_motion(); bpy.ops.f4x.save_edits()
note("untouched")

scene.frame_set(3)
bpy.ops.f4x.grab_nodes(offset=(0.3, 0.2, 0.1), reach=2.0)
arrays["offset"] = np.array(node(3).matrix_world.translation)
note("grabbed")
bpy.ops.f4x.write_motion(); bpy.ops.f4x.save_edits()
note("grabbed written")

bpy.ops.f4x.add_handles(count=3)
note("handles")
handle = bpy.data.objects["tiny handle 00"]
handle.rotation_quaternion, handle.location.x = (0.9, 0.1, 0.3, 0.0), 0.2
noted["members"] = [item["f4x_node"] for item in handle.children]
note("handle moved")
bpy.ops.f4x.write_motion(); bpy.ops.f4x.save_edits()
note("handle written")
bpy.ops.f4x.remove_handles()
noted["left"] = [item.name for item in scene.objects if "f4x_handle" in item]
note("handles gone")

node(5).animation_data_clear()  # an artist's own ways: no keys, a constraint, another size
node(5).rotation_quaternion = (0.8, 0.3, 0.2, 0.5)
node(5).constraints.new("COPY_LOCATION").target = node(7)
node(7).scale = (3, 2, 1)
bpy.ops.f4x.write_motion(); bpy.ops.f4x.save_edits()
note("constrained written")
node(5).constraints.clear()
display.refresh(SceneObject(root))

scene.frame_set(2)
select(node(3))
bpy.ops.f4x.grab_nodes(offset=(0, 0, 0.5), reach=0.0, hold="AROUND", frames=1)
bpy.ops.f4x.write_motion()
note("unsaved")
SceneObject(root).set_stack(SceneObject(root).stack.undo())
display.refresh(SceneObject(root))
note("undone")

copy = node(2).copy()
node(2).users_collection[0].objects.link(copy)
noted["copied"] = str(bpy.ops.f4x.write_motion())
bpy.data.objects.remove(copy)
bpy.data.objects.remove(node(2))
select(node(3))
noted["missing"] = refused(bpy.ops.f4x.write_motion)
select(root)
noted["none selected"] = bpy.ops.f4x.grab_nodes.poll()
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    write_scene(tiny_scene(), folder / "tiny.f4x")
    noted, arrays = perform(folder, CHILD, CLIP)
    return folder, arrays, noted


def error(session, label: str, file: str) -> float:
    """Largest distance between the points in Blender and where the core has those of the file, over the clip."""
    folder, found, _ = session
    scene, worst = open_scene(folder / f"{file}.f4x"), 0.0
    for frame in range(CLIP):
        posed = scene.posed(frame)
        worst = max(worst, float(np.abs(found[f"{label}/{frame}"] - posed.means[posed.dynamic]).max()))
    print(f"{label} against {file}: {worst:.1e}")
    return worst


WRITTEN = ("untouched", "grabbed written", "handle written", "handles gone", "constrained written", "undone")


@pytest.mark.parametrize("label", WRITTEN)
def test_the_core_poses_what_was_written(session, label):
    assert error(session, label, label) < 1e-5


@pytest.mark.parametrize(
    ("label", "before"),
    [("grabbed", "untouched"), ("handle moved", "handles"), ("constrained written", "handle written"),
     ("unsaved", "constrained written")],
)  # fmt: skip
def test_each_step_moved_something(session, label, before):
    assert error(session, label, before) > 0.05


def test_handles_move_nothing_by_themselves(session):
    assert error(session, "handles", "grabbed written") < 1e-5


def test_undoing_a_written_edit_takes_the_nodes_back(session):
    assert error(session, "undone", "constrained written") < 1e-5


def test_the_stack_grows_by_what_changed(session):
    folder, _, result = session
    assert len(read_stack(folder / "untouched.f4x")) == 0
    counts = [len(read_stack(folder / f"{label}.f4x")) for label in ("grabbed written", "handle written", "undone")]
    assert counts == [1, 2, 3]
    first, second, third = (edit.operation for edit in read_stack(folder / "undone.f4x").edits)
    assert set(second.nodes) == set(result["members"]) and len(second.times) == CLIP
    assert third.nodes == (15,) and {edit.sentence for edit in read_stack(folder / "undone.f4x").edits} == {
        "moved in Blender"
    }
    assert 9 in first.nodes


def test_the_grabbed_node_is_where_it_was_put(session):
    _, found, _ = session
    scene = tiny_scene()
    place = scene.scaffold.xyz[2, 3] @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # frame 3; (x, z, -y)
    np.testing.assert_allclose(found["offset"], place + np.array([0.3, 0.2, 0.1]), atol=1e-5)


def test_the_graph_follows_the_nodes_and_is_hidden(session):
    _, found, result = session
    assert result["graph hidden"] == [True, True]
    np.testing.assert_allclose(found["graph"], tiny_scene().scaffold.xyz[3], atol=1e-5)  # frame 4 is knot 3


def test_what_cannot_be_written_is_one_sentence(session):
    _, _, result = session
    assert result["copied"] == "{'FINISHED'}"  # a copy carries nothing
    assert "1 node is missing" in result["missing"] and "Traceback" not in result["missing"] and result["left"] == []
    assert result["none selected"] is False
