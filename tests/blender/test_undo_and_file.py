"""Ctrl-Z and the scene file: what the panel says of the file is read in the file, and undone edits stay undone."""

from dataclasses import replace

from f4x_core.edit.apply import open_scene
from f4x_core.scene import read_scene, write_scene

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))

def note(name):
    noted[name] = dict(saved=scene_object().is_saved, stack=[edit.operation.TAG for edit in scene_object().stack.edits],
                       label=scene_object().saving, file=stack_in_file())
"""
UNDONE = """
ops.query_text(text="square"); push("query")
ops.recolour(rgb=(0, 1, 0)); push("recolour"); note("recoloured")
ops.save_edits(); push("save"); note("saved")
bpy.ops.ed.undo(); note("undone once")
bpy.ops.ed.undo(); note("undone twice")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
bpy.ops.ed.redo(); note("redone")
bpy.ops.ed.undo()
ops.save_edits(); push("save"); note("saved without")
"""


def test_an_edit_undone_past_its_save_is_told_and_leaves_the_file_with_the_next_save(folder):
    noted, _ = perform(folder, START + UNDONE)
    assert noted["recoloured"]["stack"] == ["recolour"] and not noted["recoloured"]["saved"]
    assert noted["saved"]["saved"] and noted["saved"]["file"] == ["recolour"]
    assert noted["undone once"]["stack"] == ["recolour"] and noted["undone once"]["saved"]
    assert noted["undone twice"]["stack"] == [] and noted["undone twice"]["file"] == ["recolour"]
    assert not noted["undone twice"]["saved"] and noted["undone twice"]["label"] == "Remove 1 Edit from Scene File"
    assert noted["redone"]["saved"] and noted["redone"]["label"] == "Edits Saved"
    assert noted["saved without"]["file"] == [] and noted["saved without"]["saved"]


def test_a_blend_remembers_which_edits_of_the_file_were_undone(folder):
    script = START + UNDONE.rpartition("bpy.ops.ed.redo()")[0]
    again = """
bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
note("opened")
ops.save_edits(); note("saved")
"""
    noted, _ = perform(folder, script + again)
    assert not noted["opened"]["saved"] and noted["opened"]["label"] == "Remove 1 Edit from Scene File"
    assert noted["saved"]["file"] == []


def test_a_file_that_blender_saved_by_itself_remembers_it_too(folder):
    script = START + UNDONE.partition("bpy.ops.wm.save")[0]
    again = """
bpy.app.handlers.save_pre.clear()  # an auto-save tells nobody
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "auto.blend"), copy=True)
bpy.ops.wm.open_mainfile(filepath=str(folder / "auto.blend"))
note("opened")
"""
    noted, _ = perform(folder, script + again)
    assert noted["opened"]["label"] == "Remove 1 Edit from Scene File"


def test_what_another_program_wrote_is_seen_and_stays(folder):
    other = """
from feature4x.f4x_core.edit.operations import Opacity
from feature4x.f4x_core.edit.selects import All
from feature4x.f4x_core.edit.stack import read_stack, write_stack
file = folder / "scene.f4x"
write_stack(file, read_stack(file).append(Opacity(All(), 0.5)))
note("written by another")
ops.save_edits(); push("save"); note("merged")
"""
    noted, _ = perform(folder, START + UNDONE + other)
    assert (
        not noted["written by another"]["saved"]
        and noted["written by another"]["label"] == "Load Edits from Scene File"
    )
    assert noted["merged"]["saved"] and noted["merged"]["stack"] == noted["merged"]["file"] == ["opacity"]


def test_written_motion_pends_until_it_is_saved(tiny_folder):
    script = """
show_nodes()
node = bpy.data.objects["tiny node 00003"]
select(node); push("selected")
ops.grab_nodes(offset=(0.3, 0, 0), reach=0.0); push("grabbed")
ops.write_motion(); push("written"); note("written")
bpy.ops.ed.undo(); note("undone")
"""
    noted, _ = perform(tiny_folder, START + script)
    assert noted["written"]["stack"] == ["rekey"] and noted["written"]["file"] == [] and not noted["written"]["saved"]
    assert noted["undone"]["stack"] == [] and noted["undone"]["saved"]


def test_undo_past_new_words_of_a_job_keeps_the_scene(folder):
    """A job that adds words writes other arrays into the file; what the scene is stays the same."""
    scene = read_scene(folder / "scene.f4x")
    words = scene.features.vocabularies["words"]
    more = replace(words, labels=(*words.labels, "edge"), vectors=words.vectors[[*range(len(words.labels)), 0]])
    write_scene(replace(scene, features=replace(scene.features, vocabularies={"words": more})), folder / "more.f4x")
    script = """
import shutil
ops.query_text(text="square"); push("query")
ops.recolour(rgb=(0, 1, 0)); push("recolour"); ops.save_edits(); push("save")
text = json.dumps([edit.to_json() for edit in scene_object().stack.edits])
from feature4x.f4x_core.edit.stack import read_stack, write_stack
write_stack(folder / "more.f4x", read_stack(folder / "scene.f4x"))
shutil.copy(folder / "more.f4x", folder / "scene.f4x")
scene_object().attach(); push("job")
ops.query_text(text="edge"); noted["found"] = root().f4x.selected
bpy.ops.ed.undo(); bpy.ops.ed.undo()
ops.query_text(text="square"); noted["after"] = root().f4x.selected
"""
    noted, _ = perform(folder, START + script)
    assert noted["found"] > 0 and noted["after"] > 0


def test_edits_of_a_packed_scene_are_saved_in_the_blend(folder):
    script = """
ops.pack_scene()
(folder / "scene.f4x").unlink()
ops.query_text(text="square")
ops.recolour(rgb=(0, 1, 0))
noted["before"] = scene_object().is_saved
ops.save_edits()
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
from feature4x.f4x_core.edit.stack import read_stack
noted["file"] = len(read_stack(scene_object().path))
noted["saved"], noted["left"] = scene_object().is_saved, [image.name for image in bpy.data.images]
"""
    noted, _ = perform(folder, START + script)
    assert not noted["before"] and noted["saved"] and noted["file"] == 1 and len(noted["left"]) == 1


OTHER = """
import subprocess
other = '''
import sys, time
sys.path.insert(0, sys.argv[1])
from f4x_core.edit.apply import stack_of
from f4x_core.edit.operations import Duplicate, Opacity
from f4x_core.edit.selects import All, Ids
from f4x_core.edit.stack import write_stack
from f4x_core.scene import read_scene, updating
file, what = sys.argv[2:]
for _ in range(20):
    with updating(file):
        print("holds it", flush=True)
        time.sleep(60 if what == "hold" else 0)
        operation = Duplicate(Ids.of([0, 1, 2]), (1, 0, 0)) if what == "copy" else Opacity(All(), 0.9)
        write_stack(file, stack_of(read_scene(file), operation))
    if what == "copy":
        break
'''

def start(what):
    command = [sys.executable, "-c", other, sys.argv[1], str(folder / "scene.f4x"), what]
    found = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    found.stdout.readline()
    return found
"""


def test_saving_beside_other_writers_loses_nothing(folder):
    """Refused where another writer holds the file, also when that one dies; copies of both sides stay; no round loses an edit."""
    script = """
ops.query_text(text="square"); ops.duplicate()
child = start("hold")
noted["refused"] = refused(ops.save_edits)
child.kill(); child.wait()
start("copy").wait()
ops.save_edits(); note("copies")
def save():
    # A writer that takes the lock again at once leaves a moment's gap, which on a busy machine a second's looking misses.
    while True:
        try:
            return ops.save_edits()
        except RuntimeError as error:
            if "another program is changing this scene" not in str(error):
                raise

child = start("often")
for _ in range(20):
    ops.recolour(rgb=(0, 1, 0)); save()
child.wait()
ops.save_edits(); note("often")
noted["left"] = sorted(file.name for file in folder.iterdir())
"""
    noted, _ = perform(folder, START + OTHER + script)
    assert "another program is changing this scene" in noted["refused"]
    assert noted["copies"]["file"] == noted["copies"]["stack"] == ["duplicate"] * 2
    counts = {tag: noted["often"]["file"].count(tag) for tag in ("duplicate", "recolour", "opacity")}
    assert counts == {"duplicate": 2, "recolour": 20, "opacity": 20} and noted["often"]["saved"]
    assert noted["left"] == ["scene.f4x"] and len(open_scene(folder / "scene.f4x").edits) == 42
