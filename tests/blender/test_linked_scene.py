"""A scene of another .blend, linked or overridden: operators, and renders of edits over time, say why they do not work."""

from .artist import perform

SCRIPT = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
ops.query_text(text="square")
ops.transform(move=(0.0, 0.0, 0.25), over_time=True, first=1, last=4)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "lib.blend"))

def with_camera():
    scene = bpy.context.scene
    scene.camera = next(item for item in scene.objects if item.type == "CAMERA")
    scene.render.resolution_x, scene.render.resolution_y = 64, 40

def open_linked():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(folder / "lib.blend"), link=True) as (_, into):
        into.collections = ["labelled"]
    return into.collections[0]

def attempts(root):
    bpy.context.view_layer.objects.active = root
    calls = {"query": lambda: ops.query_text(text="square"), "recolour": lambda: ops.recolour(rgb=(1, 0, 0)),
             "hide": lambda: ops.hide(what="OTHERS"), "save": lambda: ops.save_edits(),
             "plan": lambda: ops.plan(sentence="make the square red"), "handles": lambda: ops.add_handles(count=1),
             "write": lambda: ops.write_motion(), "pack": lambda: ops.pack_scene()}
    said = {name: refused(call) for name, call in calls.items()}
    root.f4x.show_score = True
    root.f4x.threshold = 0.3
    with_camera()
    bpy.context.scene.frame_set(3)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
    bpy.context.scene.render.engine = "FEATURE4X"
    said["render"] = refused(bpy.ops.render.render)
    return said

collection = open_linked()
def overridden():
    return collection.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)

if overridden() is None:  # Blender 5.3 overrides what is in the scene
    bpy.context.scene.collection.children.link(collection)
    overridden()
    if collection.name in bpy.context.scene.collection.children:
        bpy.context.scene.collection.children.unlink(collection)
root_object = next(item for item in bpy.context.scene.objects if "f4x_path" in item)
noted["override"] = attempts(root_object)
collection = open_linked()
bpy.context.scene.collection.children.link(collection)
root_object = next(item for item in bpy.context.scene.objects if "f4x_path" in item)
noted["link"] = attempts(root_object)
select(*bpy.context.scene.objects)
bpy.ops.object.make_local(type="ALL")
root_object = next(item for item in bpy.context.scene.objects if "f4x_path" in item)
bpy.context.view_layer.objects.active = root_object
bpy.ops.f4x.query_text(text="square")
bpy.ops.f4x.recolour(rgb=(1, 0, 0))
noted["local"] = len(SceneObject(root_object).stack)
bpy.ops.render.render()
"""


def test_a_linked_scene_refuses_in_one_sentence_and_works_once_it_is_local(folder):
    noted, _ = perform(folder, SCRIPT)
    for how in ("override", "link"):
        for name, said in noted[how].items():
            assert "belongs to another .blend" in said and "Traceback" not in said, (how, name, said)
    assert noted["local"] == 2


def test_what_looks_like_a_scene_and_is_none_is_named(folder):
    script = """
from feature4x.addon.scene.scene_object import why_none, why_not
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
noted["whole"] = why_none(bpy.context.object)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "lib.blend"))
bpy.data.objects.remove(root())
noted["without root"], noted["refused"] = why_none(bpy.context.object), why_not(bpy.context.object)
bpy.ops.wm.read_factory_settings(use_empty=True)
noted["empty"], noted["nothing"] = why_none(bpy.context.object), why_not(bpy.context.object)
with bpy.data.libraries.load(str(folder / "lib.blend"), link=True) as (_, into):
    into.collections = ["labelled"]
item = bpy.data.objects.new("link", None)
item.instance_type, item.instance_collection = "COLLECTION", into.collections[0]
bpy.context.scene.collection.objects.link(item)
select(item)
noted["link"] = why_none(item)
"""
    noted, _ = perform(folder, script)
    assert noted["whole"] == noted["empty"] == "" and noted["nothing"].startswith("Import a Feature4X scene")
    assert "lost its root" in noted["without root"] and noted["refused"] == noted["without root"].rstrip(".")
    assert "link is a link to a scene of another .blend" in noted["link"]
