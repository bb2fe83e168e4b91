"""Points deleted or moved in Edit Mode: a warning, an edit by one click, and undo."""

import numpy as np
from labelled_scene import labelled_scene

from f4x_core.edit.apply import edited
from f4x_core.scene import read_scene

from .artist import perform

START = """
from feature4x.addon.operators import point_edits
from feature4x.addon.common.point_cloud import write_attribute
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
push("imported")

def in_edit_mode(cloud, chosen, work):
    select(cloud)
    write_attribute(cloud.data, ".selection", "BOOLEAN", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
    work()
    bpy.ops.object.mode_set(mode="OBJECT")
    push("edited points")

def clouds():
    there = [cloud for cloud in scene_object().clouds if len(cloud.data.points)]
    return sorted(there, key=lambda cloud: ("edited" in cloud.name, "dynamic" in cloud.name))

def shown():
    return sorted(np.concatenate([values(cloud, "gid") for cloud in clouds()]).tolist())
"""


def test_deleted_points_become_a_removal(folder):
    script = """
static, dynamic = clouds()
noted["before"] = point_edits.summary(scene_object())
for cloud in (static, dynamic):
    in_edit_mode(cloud, np.arange(len(cloud.data.points)) < 30, bpy.ops.pointcloud.delete)
noted["summary"] = point_edits.summary(scene_object())
left = shown()
ops.take_over_points("EXEC_DEFAULT", True)
noted["after"] = [point_edits.summary(scene_object()), scene_object().is_saved, shown() == left]
noted["whole"] = [len(cloud.data.points) for cloud in clouds()]
noted["edits"] = [row.name for row in root().f4x.history]
ops.save_edits()
ops.restore("EXEC_DEFAULT", True)
noted["restored"] = len(shown())
arrays["moved"] = values(clouds()[1])
ops.history("EXEC_DEFAULT", True, how="CLEAR")
arrays["posed"] = scene_object().base.posed(0.0).means
"""
    noted, arrays = perform(folder, START + script)
    scene = labelled_scene()
    sizes = [len(scene.static), len(scene.dynamic)]
    assert (
        noted["before"] == "" and noted["summary"] == "Changed by Blender's own tools and not yet an edit: 60 deleted"
    )
    assert noted["after"] == ["", False, True] and noted["whole"] == sizes
    assert noted["edits"] == ["remove 60 Gaussians"] and noted["restored"] == sum(sizes)
    saved = edited(read_scene(folder / "scene.f4x"))
    assert saved.rows.gone.sum() == 60
    np.testing.assert_allclose(arrays["moved"], arrays["posed"][sizes[0] :], atol=1e-5)


def test_moved_points_become_a_transform_and_what_cannot_is_put_back(folder):
    script = """
static, dynamic = clouds()
def shift(cloud, count, way):
    positions = read_attribute(cloud.data, "position")
    positions[:count] += way
    write_attribute(cloud.data, "position", "FLOAT_VECTOR", positions)
    cloud.data.update_tag(); bpy.context.view_layer.update()
arrays["at import"] = read_attribute(dynamic.data, "position")
shift(static, 50, np.float32([0.1, 0.2, 0.3])); shift(dynamic, 5, np.float32([1, 0, 0]))
noted["summary"] = point_edits.summary(scene_object())
push("moved")
ops.take_over_points("EXEC_DEFAULT", True)
noted["after"] = [point_edits.summary(scene_object()), len(scene_object().stack)]
frame = scene_object().frame
ids = read_attribute(static.data, "gid")[:50]
arrays["posed"] = scene_object().edited.posed(frame).means[:50]
arrays["dynamic"] = read_attribute(clouds()[1].data, "position")
bpy.ops.ed.undo()
noted["undone"] = [len(scene_object().stack), point_edits.summary(scene_object())]
ops.put_back_points("EXEC_DEFAULT", True)
noted["put back"] = point_edits.summary(scene_object())
noted["nothing"] = refused(ops.take_over_points)
shift(clouds()[1], 5, np.float32([1, 0, 0]))
noted["only moving"] = refused(ops.take_over_points)
"""
    noted, arrays = perform(folder, START + script)
    assert noted["summary"] == "Changed by Blender's own tools and not yet an edit: 55 moved" and noted["after"] == [
        "",
        1,
    ]
    expected = labelled_scene().static.means[:50] + np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(arrays["posed"], expected, atol=1e-6)
    np.testing.assert_array_equal(arrays["dynamic"], arrays["at import"])
    assert noted["undone"] == [0, noted["summary"]] and noted["put back"] == ""
    assert "No point" in noted["nothing"] and "5 moved points cannot become an edit" in noted["only moving"]


def test_a_point_cloud_that_was_deleted_as_a_whole_becomes_one_removal(folder):
    script = """
static, dynamic = clouds()
count = len(static.data.points)
bpy.data.objects.remove(static)
noted["summary"] = point_edits.summary(scene_object())
noted["put back"] = refused(ops.put_back_points)
ops.take_over_points("EXEC_DEFAULT", True)
point_edits._found.clear()  # in a window Blender tells of the change
noted["after"] = [point_edits.summary(scene_object()), len(scene_object().stack), count]
noted["again"] = refused(ops.take_over_points)
"""
    noted, _ = perform(folder, START + script)
    count = noted["after"][2]
    assert f"{count:,} deleted" in noted["summary"] and f"{count:,} Gaussians is gone" in noted["put back"]
    assert noted["after"][:2] == ["", 1] and "No point was deleted" in noted["again"]
