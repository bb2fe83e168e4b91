"""Splats of another program are a scene like any other, and a project that is under way keeps its settings."""

from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.stack import read_stack
from f4x_core.scene import read_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export

from .artist import perform

FORMAT_OF = {".ply": "ply", ".splat": "splat", ".spz": "spz", ".glb": "gltf"}
FACTORY = "bpy.ops.wm.read_factory_settings(use_empty=False)\n"


@pytest.mark.parametrize("name", ["frame.ply", "frame.splat", "frame.spz", "frame.glb"])
def test_a_splat_file_is_selected_edited_undone_and_saved_as_a_scene(tmp_path, name):
    export(labelled_scene(features=False), tmp_path / name, [0], FORMAT_OF[Path(name).suffix])
    before = (tmp_path / name).read_bytes()
    script = f"""
noted["timeline"] = []
def timeline():
    scene = bpy.context.scene
    noted["timeline"].append([scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps])
timeline()
ops.import_scene("EXEC_DEFAULT", True, filepath=str(folder / "{name}"))
timeline()
push("imported")
noted["total"] = root().f4x.total
scene_object().base  # which a search starts from
ops.query_point("EXEC_DEFAULT", True, frame=0, at=(480, 270))
noted["point"] = root().f4x.selected
ops.select_box("EXEC_DEFAULT", True, box=(600, 200, 1200, 800), through=True)
noted["box"] = root().f4x.selected
ops.remove("EXEC_DEFAULT", True)
noted["removed"] = [root().f4x.total, scene_object().is_saved]
bpy.ops.ed.undo()
noted["undone"] = [len(scene_object().stack)]
ops.remove("EXEC_DEFAULT", True)
ops.plan(sentence="make everything red")
ops.apply_plan("EXEC_DEFAULT", True)
noted["edits"] = [row.name for row in root().f4x.history]
noted["save"] = refused(ops.save_edits)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
noted["beside"] = sorted(path.name for path in folder.iterdir())
bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
noted["reopened"] = len(scene_object().stack)
ops.save_as(filepath=str(folder / "cleaned"))
noted["saved"] = [scene_object().path.name, scene_object().is_saved, scene_object().saving]
"""
    noted, _ = perform(tmp_path, FACTORY + script)
    assert noted["timeline"] == [[1, 250, 1, 24]] * 2
    assert 0 < noted["box"] < noted["total"] and 0 < noted["point"] <= noted["total"]
    assert noted["removed"] == [noted["total"] - noted["box"], False] and noted["undone"] == [0]
    assert len(noted["edits"]) == 2 and noted["reopened"] == 2
    assert "Save As Scene" in noted["save"] and noted["beside"] == [name, "scene.blend"]
    assert noted["saved"] == ["cleaned.f4x", True, "Edits Saved"]
    assert (tmp_path / name).read_bytes() == before
    assert len(read_stack(tmp_path / "cleaned.f4x").edits) == 2
    assert len(read_scene(tmp_path / "cleaned.f4x").ids) == len(open_any(tmp_path / name).ids)


@pytest.mark.parametrize(
    ("before", "changed", "words"),
    [
        ("", True, ""),
        ("scene.render.fps = 30", False, "rate 30 fps (clip: 24)"),
        ("scene.frame_end = 90", False, "frames 1-90 (clip: 0-5)"),
        ("scene.render.resolution_x = 1280", False, "size 1280 x 1080 (clip: 64 x 40)"),
        ("scene.view_settings.view_transform = 'Filmic'; scene.camera.location.x = 0", False, "transform Filmic"),
        ("scene.camera.keyframe_insert('location')", False, "camera 'Camera'"),
        ("bpy.ops.mesh.primitive_torus_add()", False, "Set Up Render takes"),
        ("bpy.ops.wm.save_as_mainfile(filepath=str(folder / 'a.blend'))", False, "Set Up Render takes"),
        ("load(); scene.render.fps = 30", False, "rate 30 fps (clip: 24)"),
        ("load(); bpy.ops.ed.undo_push(); [bpy.data.objects.remove(i) for i in list(bpy.data.objects)]", True, ""),
    ],
)
def test_a_project_that_is_under_way_keeps_its_settings(folder, before, changed, words):
    script = f"""
scene = bpy.context.scene
def load():
    ops.import_scene(filepath=str(folder / "scene.f4x"))
def settings():
    render = scene.render
    camera = scene.camera.name if scene.camera else ""
    return [render.resolution_x, render.resolution_y, render.fps, scene.frame_start, scene.frame_end, camera,
            scene.view_settings.view_transform, render.engine]
{before}
found = settings()
load()
noted["changed"] = settings() != found
noted["line"] = root().f4x.notice
ops.set_up_render()
noted["asked"] = [settings(), root().f4x.notice]
"""
    noted, _ = perform(folder, FACTORY + script)
    assert noted["changed"] is changed and words in noted["line"]
    settings, line = noted["asked"]
    assert settings[:5] == [64, 40, 24, 0, 5] and settings[5].startswith("labelled") and settings[6] == "Standard"
    assert "Left" not in line
