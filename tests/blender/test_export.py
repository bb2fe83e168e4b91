"""Exporting in Blender's own Python: what is seen, saved or not, without the worker."""

from dataclasses import replace

import numpy as np
from labelled_scene import labelled_scene

from f4x_core.scene import write_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export

from .artist import perform

START = """
os.environ.pop("F4X_PYTHON", None)
from feature4x.addon.operators import exporting
noted["poll"] = ops.export_scene.poll()
"""


def test_what_is_seen_is_exported_without_the_worker(folder):
    script = """
noted["in the menu"] = any(f.__name__ == "_draw_export" for f in bpy.types.TOPBAR_MT_file_export._dyn_ui_initialize())
ops.import_scene(filepath=str(folder / "scene.f4x"))
bpy.context.scene.frame_set(3)
ops.export_scene(filepath=str(folder / "plain.ply"))
ops.query_text(text="square")
noted["square"] = root().f4x.selected
ops.export_scene(filepath=str(folder / "square.splat"), selected_only=True)
ops.remove()
ops.export_scene(filepath=str(folder / "edited.ply"))
ops.export_scene(filepath=str(folder / "unedited.ply"), with_edits=False)
static = next(cloud for cloud in scene_object().clouds if "static" in cloud.name)
from feature4x.addon.common.point_cloud import write_attribute
write_attribute(static.data, ".selection", "BOOLEAN", np.arange(len(static.data.points)) < 20)
select(static)
bpy.ops.object.mode_set(mode="EDIT"); bpy.ops.pointcloud.delete(); bpy.ops.object.mode_set(mode="OBJECT")
ops.export_scene(filepath=str(folder / "deleted.spz"))
ops.export_scene(filepath=str(folder / "walk.ply"), frames="ALL")
ops.export_scene(filepath=str(folder / "walk"), frames="ALL", format="usd")
noted["saved"] = scene_object().is_saved
noted["ending"] = refused(ops.export_scene, filepath=str(folder / "a.obj"))
noted["away"] = refused(ops.export_scene, filepath="/dev/null/a.ply")
(folder / "scene.f4x").rename(folder / "gone.f4x")
noted["missing"] = refused(ops.export_scene, "INVOKE_DEFAULT", filepath=str(folder / "b.ply"))
"""
    noted, _ = perform(folder, START + script)
    scene = labelled_scene()
    count = len(scene.ids)
    assert noted["poll"] is False and noted["in the menu"] and not noted["saved"]
    plain = open_any(folder / "plain.ply").static
    np.testing.assert_allclose(plain.means, scene.posed(3.0).means, atol=1e-6)
    sizes = {name: len(open_any(folder / name).ids) for name in ("edited.ply", "unedited.ply", "deleted.spz")}
    without = count - noted["square"]
    assert sizes == {"edited.ply": without, "unedited.ply": count, "deleted.spz": without - 20}
    assert len(open_any(folder / "square.splat").ids) == noted["square"]
    assert len(list((folder / "walk").glob("labelled_*.ply"))) == 6 and (folder / "walk.usda").is_file()
    assert "there is no export to .obj" in noted["ending"] and "/dev/null" in noted["away"]
    assert "cannot be read" in noted["missing"]


def test_splats_of_another_program_are_cleaned_and_exported(tmp_path):
    export(labelled_scene(features=False), tmp_path / "frame.ply", [0])
    script = """
ops.import_scene(filepath=str(folder / "frame.ply"))
ops.select_box(box=(600, 200, 1200, 800), through=True)
noted["selected"] = root().f4x.selected
ops.remove()
ops.export_scene(filepath=str(folder / "cleaned.ply"))
noted["itself"] = refused(ops.export_scene, filepath=str(folder / "frame.ply"))
"""
    noted, _ = perform(tmp_path, "bpy.ops.wm.read_factory_settings(use_empty=True)\n" + START + script)
    assert "is read from" in noted["itself"]
    left = len(open_any(tmp_path / "frame.ply").ids) - noted["selected"]
    assert 0 < len(open_any(tmp_path / "cleaned.ply").ids) == left


TARGETS = (
    ("out.ply", "auto", True, "ply", "out.ply"),
    ("out", "auto", True, "ply", "out.ply"),
    ("out.ply", "auto", False, "ply", "out"),
    ("out.ply", "spz", True, "spz", "out.spz"),
    ("out.glb", "auto", True, "gltf", "out.glb"),
    ("my.scene", "ply", True, "ply", "my.scene.ply"),
    ("out.usda", "auto", False, "usd", "out.usda"),
    ("out.ply", "usd", True, "usd", "out.usda"),
)


def test_the_name_of_the_file_goes_with_the_format(tmp_path):
    script = f"""
for path, format, one, *_ in {TARGETS}:
    name, output = exporting.target_of(Path(path), format, one)
    noted.setdefault("found", []).append([name, str(output)])
"""
    noted, _ = perform(tmp_path, START + script)
    assert noted["found"] == [list(case[3:]) for case in TARGETS]


def test_a_moved_clip_is_found_or_asked_for_before_a_job_starts(tmp_path):
    scene = labelled_scene()
    write_scene(replace(scene, provenance={"source": str(tmp_path / "was/clip")}), tmp_path / "scene.f4x")
    script = """
from feature4x.addon.operators import tasks
started = []
tasks.start_verb = lambda title, done, *arguments: started.append([str(each) for each in arguments])
ops.import_scene(filepath=str(folder / "scene.f4x"))
noted["gone"] = refused(ops.add_features)
(folder / "clip").mkdir()
ops.add_features()
ops.add_features(clip="/elsewhere")
noted["clips"] = [each[each.index("--clip") + 1] for each in started]
"""
    noted, _ = perform(tmp_path, START + script)
    assert "is no longer at" in noted["gone"] and "choose it under Clip" in noted["gone"] and "--" not in noted["gone"]
    assert noted["clips"] == [str(tmp_path / "clip"), "/elsewhere"]
