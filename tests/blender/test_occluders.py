"""What stands before the clip's camera in the file that a scene is imported into."""

from labelled_scene import SQUARE, WALL

from .artist import perform

SCRIPT = f"""
def fresh(empty=True):
    bpy.ops.wm.read_factory_settings(use_empty=empty)

def cube(name, size, place):
    bpy.ops.mesh.primitive_cube_add(size=size, location=place)
    bpy.context.object.name = name

def hidden(**options):
    ops.import_scene(filepath=str(folder / "scene.f4x"), **options)
    names = [item.name for item in bpy.context.scene.objects if item.type == "MESH" and not item.name.startswith("labelled")]
    shown = [name for name in names if bpy.data.objects[name].visible_get() != (not bpy.data.objects[name].hide_render)]
    assert not shown, shown
    return [name for name in names if bpy.data.objects[name].hide_render]

fresh(False)
push("start")
noted["default"] = hidden()
push("imported")
bpy.ops.ed.undo()
noted["undone"] = bpy.data.objects["Cube"].hide_render
fresh(False); noted["asked not to"] = hidden(clear_view=False)
fresh(False); noted["own camera"] = hidden(set_up_render=False)
fresh()
cube("dome", 100, (0, 0, 0)); cube("prop", 0.15, (0.1, {SQUARE} - 0.2, 0)); cube("behind", 0.5, (0, -1, 0))
cube("floor", 0.2, (0, {WALL} / 2, -0.6))
noted["set"] = hidden(set_up_render=True)
fresh()
cube("outer", 1.2, (0, 0, 0)); cube("inner", 0.5, (0, 0, 0))
noted["nested"] = hidden(set_up_render=True)
"""


def test_what_covers_the_view_is_hidden_and_what_stands_in_it_stays(folder):
    noted, _ = perform(folder, SCRIPT)
    assert noted["default"] == ["Cube"] and noted["undone"] is False
    assert noted["asked not to"] == noted["own camera"] == noted["set"] == []
    assert sorted(noted["nested"]) == ["inner", "outer"]


def test_the_line_names_it(folder):
    script = """
bpy.ops.wm.read_factory_settings(use_empty=False)
ops.import_scene(filepath=str(folder / "scene.f4x"))
noted["new file"] = root().f4x.notice  # Blender's own cube is no news for long
bpy.ops.wm.read_factory_settings(use_empty=False)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "project.blend"))
ops.import_scene(filepath=str(folder / "scene.f4x"), set_up_render=True)
noted["project"] = root().f4x.notice
ops.dismiss_notice()
noted["dismissed"] = root().f4x.notice
"""
    noted, _ = perform(folder, script)
    assert noted["project"] == ("Hidden, as it was in the way: Cube.")
    assert noted["new file"] == noted["dismissed"] == ""
