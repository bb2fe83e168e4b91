"""The fields of a row of the list of edits: Blender properties that read and write the stack, and show what they change."""

import json

import numpy as np
import pytest

from f4x_core.edit.operations import (
    Blur,
    Duplicate,
    Freeze,
    Glow,
    Grade,
    Loop,
    Opacity,
    Recolour,
    Retime,
    Style,
    Transform,
)
from f4x_core.edit.selects import Ids
from f4x_core.edit.stack import of
from f4x_core.scene import read_scene, write_scene

from .artist import perform
from .test_presence import fading_scene

SOME = Ids.of(np.arange(100))

HEAD = """
from math import pi
from feature4x.addon.edits import display, fields, listing
from feature4x.addon.io.import_scene import import_scene
from feature4x.f4x_core.edit.operations import read_operation
bpy.ops.wm.read_factory_settings(use_empty=True)
root = import_scene(folder / "scene.f4x")
bpy.context.view_layer.objects.active = root
shot, state = SceneObject(root), root.f4x
"""


# what is set, and the fields that the edit then has; places are along Blender's axes: (x, y, z) is the scene's (x, -z, y)
CHANGES = [
    (Recolour(SOME, (1.0, 0.0, 0.0)), {"rgb": (0.1, 0.2, 0.9), "strength": 0.5}, {"rgb": (0.1, 0.2, 0.9), "strength": 0.5}),
    (Recolour(SOME, (1.0, 0.0, 0.0)), {"mode": "hue", "keep_luminance": True}, {"mode": "hue", "keep_luminance": True}),
    (Opacity(SOME, 0.5), {"use_frames": True, "first": 2, "last": 4}, {"frames": (2.0, 4.0)}),
    (
        Opacity(SOME, 0.5, (1.0, 3.0)),
        {"until_end": True, "ease": "smooth", "inward": True},
        {"frames": (1.0, None), "ease": "smooth", "inward": True},
    ),
    (Opacity(SOME, 0.5, (1.0, 3.0)), {"first": 4}, {"frames": (4.0, 4.0)}),
    (Opacity(SOME, 0.5, (1.0, 3.0), "linear"), {"use_frames": False, "factor": 0.25}, {"frames": None, "factor": 0.25}),
    (Transform(SOME), {"translate": (1, 2, 3), "scale": 2}, {"translate": (1.0, -3.0, 2.0), "scale": 2.0}),
    (Transform(SOME), {"rotate": (0, 0, 1.5), "pivot": "base"}, {"rotate": (0.0, -85.943669, 0.0), "pivot": "base"}),
    (Duplicate(SOME, (1.0, 0.0, 0.0)), {"offset": (0, 0, 1), "time_shift": 2}, {"offset": (0.0, -1.0, 0.0), "time_shift": 2.0}),
    (Freeze(SOME, 1.0), {"at": 2, "use_until": True}, {"at": 2.0, "until": 5.0}),
    (Retime(SOME, 0.5), {"speed": 2}, {"speed": 2.0}),
    (Loop(SOME, (0.0, 2.0)), {"last": 3}, {"frames": (0.0, 3.0)}),
    (Style(SOME, "gold"), {"look": "ice"}, {"look": "ice"}),
    (Grade(SOME), {"warmth": 0.5, "saturation": 0}, {"warmth": 0.5, "saturation": 0.0}),
    (Glow(SOME), {"use_rgb": True, "rgb": (0, 1, 0)}, {"rgb": (0.0, 1.0, 0.0)}),
    (Blur(SOME), {"radius": 0.1}, {"radius": 0.1}),
]  # fmt: skip
TABLE = """
for operation, settings in json.loads((folder / "changes.json").read_text()):
    shot.append(read_operation(operation))
display.refresh(shot)
before = root["f4x_edits"]
for index, edit in enumerate(shot.stack.edits):  # what is written as it was read changes nothing
    state.history_index = index
    group = getattr(state.fields, edit.operation.TAG)
    for shown in fields.SHOWN[edit.operation.TAG]:
        if shown.visible(edit.operation):
            setattr(group, shown.name, getattr(group, shown.name))
unchanged = [(a, b) for a, b in zip(json.loads(before), json.loads(root["f4x_edits"])) if a != b]
for index, (operation, settings) in enumerate(json.loads((folder / "changes.json").read_text())):
    state.history_index = index
    for name, value in settings.items():
        setattr(getattr(state.fields, operation["op"]), name, value)
bpy.ops.f4x.save_edits()
noted["left"] = [unchanged, state.answer]
"""


def test_fields_are_those_of_the_operation(tmp_path):
    write_scene(fading_scene(), tmp_path / "scene.f4x")
    table = [(operation.to_json(), settings) for operation, settings, _ in CHANGES]
    (tmp_path / "changes.json").write_text(json.dumps(table))
    assert perform(tmp_path, HEAD + TABLE)[0]["left"] == [[], ""]
    edits = of(read_scene(tmp_path / "scene.f4x")).edits
    for edit, (operation, settings, expected) in zip(edits, CHANGES, strict=True):
        for name, value in expected.items():
            assert getattr(edit.operation, name) == (pytest.approx(value) if name == "rotate" else value), settings
        others = {name for name in vars(operation) if name not in (*expected, "select", "first_id")}
        assert all(getattr(edit.operation, name) == getattr(operation, name) for name in others), settings


SESSION = """
def drawn():
    cloud = next(cloud for cloud in shot.clouds if "static" in cloud.name)
    return float(read_attribute(cloud.data, "rgb")[:100, 3].mean())

noted["alpha"] = [drawn()]
shot.append(read_operation(json.loads((folder / "opacity.json").read_text())))
display.refresh(shot)
noted["alpha"].append(drawn())
bpy.ops.ed.undo_push(message="before")
state.fields.opacity.factor = 0.25
noted["row"] = [state.history[0].name, state.history_index, state.fields.recolour.strength]
noted["alpha"].append(drawn())
bpy.ops.ed.undo_push(message="factor")
bpy.ops.ed.undo()
root = SceneObject.among(bpy.context.scene.objects)[0].root
shot, state = SceneObject(root), root.f4x
noted["undone"] = state.fields.opacity.factor
noted["alpha"].append(drawn())
(folder / "scene.f4x").rename(folder / "elsewhere.f4x")
state.fields.opacity.factor = 0.1
noted["refused"] = [state.answer, shot.stack.edits[0].operation.factor]
"""


def test_a_change_is_shown_and_undone(tmp_path):
    write_scene(fading_scene(), tmp_path / "scene.f4x")
    (tmp_path / "opacity.json").write_text(json.dumps(Opacity(SOME, 0.5).to_json()))
    noted, _ = perform(tmp_path, HEAD + SESSION)
    whole, half, quarter, undone = noted["alpha"]
    assert whole > 1.5 * half > 2.5 * quarter and undone == pytest.approx(half)
    assert noted["row"][1:] == [0, 1.0] and "opacity" in noted["row"][0]
    assert noted["undone"] == 0.5
    assert "cannot be read" in noted["refused"][0] and noted["refused"][1] == 0.5  # nothing that nobody could show


HANDLE = """
from mathutils import Matrix, Vector

def moved():
    cloud = next(cloud for cloud in shot.clouds if cloud.name.endswith("edited"))
    return np.median(read_attribute(cloud.data, "position"), 0)

def note(label):
    bpy.context.view_layer.update()
    edits = shot.stack.edits
    one = edits[0].operation if edits else None
    noted[label] = [len(edits), *([one.translate, one.rotate, one.scale] if one else [])]

shot.write(**{".selection": ("BOOLEAN", np.arange(len(shot.shown.scene.ids)) < 100)})
listing.count(shot)
before = np.median(shot.shown.scene.posed(0.0).means[:100], 0)
bpy.ops.f4x.edit_gizmo()
handle = bpy.context.object
note("new")
bpy.ops.f4x.edit_gizmo()
note("once more")
noted["on the thing"] = np.abs(np.array(handle.matrix_local.translation) - before).max().item()
bpy.ops.ed.undo_push(message="handle")
bpy.ops.transform.translate(value=(0.5, 0.0, 1.0))  # along Blender's axes
note("moved")
bpy.ops.ed.undo_push(message="moved")
noted["shown"] = (moved() - before).tolist()
bpy.ops.transform.rotate(value=1.5707963, orient_axis="Z")
bpy.ops.transform.resize(value=(2.0, 2.0, 2.0))
note("turned")
bpy.ops.ed.undo_push(message="turned")
bpy.ops.ed.undo()
root = SceneObject.among(bpy.context.scene.objects)[0].root
shot, state = SceneObject(root), root.f4x
note("undone")
noted["shown undone"] = (moved() - before).tolist()
state.fields.transform.translate = (0.0, 0.25, 0.0)
bpy.context.view_layer.update()
handle = next(item for item in root.children if "f4x_edit" in item)
noted["follows"] = list(handle.location)
bpy.ops.f4x.edit_gizmo(edit_id=shot.stack.edits[0].id)
noted["again"] = bpy.context.object == handle
bpy.ops.f4x.history(how="REMOVE", edit_id=shot.stack.edits[0].id)
noted["left"] = [item.name for item in root.children if "f4x_edit" in item]
"""


def test_a_handle_moves_the_selection_again_and_again(tmp_path):
    write_scene(fading_scene(), tmp_path / "scene.f4x")
    noted, _ = perform(tmp_path, HEAD + HANDLE)
    still = [0.0, 0.0, 0.0]
    assert noted["new"] == noted["once more"] == [1, still, still, 1.0] and noted["on the thing"] < 1e-6
    moved = [1, pytest.approx([0.5, -1.0, 0.0], abs=1e-5), still, 1.0]  # the scene's y is down
    assert noted["moved"] == noted["undone"] == moved
    assert noted["shown"] == noted["shown undone"] == pytest.approx([0.5, -1.0, 0.0], abs=1e-5)
    assert noted["turned"][0] == 1 and noted["turned"][3] == pytest.approx(2)
    assert np.abs(noted["turned"][2]) == pytest.approx([0, 90, 0], abs=1e-3)
    assert noted["follows"] == pytest.approx([0, 0.25, 0]) and noted["again"] and noted["left"] == []
