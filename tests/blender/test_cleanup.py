"""Floaters and crop boxes as edits in the stack."""

from floater_scenes import planted
from labelled_scene import labelled_scene

from f4x_core.edit.apply import edited
from f4x_core.scene import read_scene
from f4x_core.scene.formats import export

from .artist import perform


def test_floaters_of_a_splat_file_are_removed_by_an_edit(tmp_path):
    scene, floaters, _ = planted("room", 7)
    export(scene, tmp_path / "frame.ply", [0])
    script = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "frame.ply"))
push("imported")
for strength in (0.2, 0.5, 0.9):
    ops.remove_floaters("EXEC_DEFAULT", True, strength=strength)
    noted.setdefault("left", []).append(root().f4x.total)
    noted["edit"] = root().f4x.history[-1].name
    arrays["removed"] = scene_object().edited.rows.gone
    if strength == 0.5:
        arrays["half"] = arrays["removed"]
    bpy.ops.ed.undo()
noted["undone"] = len(scene_object().stack)
ops.query_text(text="floaters")
noted["selected"] = root().f4x.selected
"""
    noted, arrays = perform(tmp_path, script)
    assert noted["left"] == sorted(noted["left"], reverse=True) and len(set(noted["left"])) == 3
    assert noted["edit"] == "remove the floaters" and noted["undone"] == 0
    assert (arrays["half"] & floaters).sum() > 0.85 * max(floaters.sum(), arrays["half"].sum())
    assert noted["selected"] == arrays["half"].sum()


def test_a_crop_box_keeps_or_removes_what_is_inside_and_replaces_its_edit(folder):
    script = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "scene.f4x"))
noted["without"] = refused(ops.crop)
ops.add_crop_box("EXEC_DEFAULT", True)
box = bpy.context.object
noted["box"] = [box.name, box.empty_display_type, box.parent.name]
box.scale = (0.4, 10.0, 0.4)  # along Blender's axes
box.location = (0.5, 0.0, -0.3)
def outcome():
    gone = scene_object().edited.rows.gone
    return [len(scene_object().stack), int(gone.sum()), root().f4x.history[-1].name]
ops.crop("EXEC_DEFAULT", True, keep="INSIDE"); noted["keep"] = outcome()
arrays["kept"] = ~scene_object().edited.rows.gone
box.rotation_euler.y = 0.5
ops.crop("EXEC_DEFAULT", True, keep="OUTSIDE"); noted["remove"] = outcome()
box.location.x = 1000
noted["nothing"] = refused(ops.crop, keep="OUTSIDE")
noted["after"] = outcome()[:2]
root().location.x = 5
box.location.x, box.rotation_euler.y = 0.5, 0.0
ops.crop("EXEC_DEFAULT", True, keep="INSIDE"); noted["moved"] = outcome()
ops.save_edits()
"""
    noted, arrays = perform(folder, script)
    scene = labelled_scene()
    places = scene.posed(0).means
    inside = (abs(places[:, :2] - (0.5, 0.3)) <= 0.4).all(1)[: len(scene.static)]
    assert "no crop box" in noted["without"] and noted["box"] == ["labelled crop box", "CUBE", "labelled"]
    assert (arrays["kept"][: len(scene.static)] == inside).all()
    assert noted["keep"][::2] == [1, "remove what is outside the crop box"]
    assert noted["remove"][::2] == [1, "remove what is inside the crop box"] and 0 < noted["remove"][1] < len(scene.ids)
    assert "would remove nothing" in noted["nothing"] and noted["after"] == noted["remove"][:2]
    assert noted["moved"] == noted["keep"]
    assert edited(read_scene(folder / "scene.f4x")).rows.gone.sum() == noted["keep"][1]


def test_buttons_of_one_operator_have_tooltips_of_their_own(tmp_path):
    buttons = [
        ("crop", "keep", "OUTSIDE"),
        ("history", "how", "CLEAR"),
        ("change_selection", "how", "GROW"),
        ("hide", "what", "OTHERS"),
    ]
    script = f"""
for name, field, value in {buttons}:
    properties = bpy.context.window_manager.operator_properties_last("f4x." + name)
    setattr(properties, field, value)
    noted[name] = getattr(bpy.types, "F4X_OT_" + name).description(bpy.context, properties)
"""
    noted, _ = perform(tmp_path, script)
    assert noted["crop"].startswith("Remove everything that is in the box") and noted["history"] == "Delete all edits"
    assert len(set(noted.values())) == len(buttons)
