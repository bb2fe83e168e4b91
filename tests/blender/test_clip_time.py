"""When a clip plays: start frame, speed and Time move nodes, presence, camera, clip, edits and sentences together."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from f4x_core.edit.apply import with_operations
from f4x_core.edit.operations import Delete, Opacity, Recolour
from f4x_core.edit.selects import Ids, Moving
from f4x_core.scene import write_scene

from .artist import perform
from .test_presence import fading_scene

HEAD = """
import cv2
from feature4x.addon.scene import clip_time
from feature4x.addon.io import clip_background
from feature4x.addon.rig import motion_edits, scaffold
from feature4x.addon.io.import_scene import import_scene

def fresh(**options):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.engine = "FEATURE4X"
    root = import_scene(folder / "scene.f4x", **options)
    bpy.context.scene.render.engine = "FEATURE4X"
    return root

def picture(label, frame):
    scaffold.set_frame(bpy.context.scene, frame)
    bpy.context.scene.render.filepath = str(folder / "out.png")
    bpy.ops.render.render(write_still=True)
    arrays[label] = cv2.imread(str(folder / "out.png"))
    root = SceneObject.among(bpy.context.scene.objects)[0]
    user = [image.image_user.frame_offset for image in bpy.context.scene.camera.data.background_images]
    noted[label] = [root.frame, motion_edits.unwritten(root), *user]
"""
TIMES = [0.0, 1.0, 2.0, 2.5, 4.0, 5.0]
PICTURES = """
root = fresh(clip=folder / "images")
noted["axes"] = [root.empty_display_size, bpy.context.scene.camera.data.clip_start]
for time in TIMES:
    picture(f"plain {time}", time)

def shown(label, frame_of):
    for time in TIMES:
        picture(f"{label} {time}", frame_of(time))

root.f4x.start_frame = 101
shown("start", lambda time: 101 + time)
root.f4x.speed = 0.8
shown("speed", lambda time: 101 + time / 0.8)
root.f4x.animate_time = True
shown("as before", lambda time: 101 + time / 0.8)
for key in clip_time._time_curve(root).keyframe_points:
    key.co[1] = 5 - key.co[1]
shown("reverse", lambda time: 101 + (5 - time) / 0.8)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "reverse.blend"))
root.driver_remove('["f4x_time"]')
root.animation_data.action = None
driver = root.driver_add('["f4x_time"]').driver
driver.expression = "5 * frame / 20"
shown("driven", lambda time: 4 * time)
root.driver_remove('["f4x_time"]')
for time in TIMES:
    root["f4x_time"] = time
    root.update_tag()
    picture(f"still {time}", 50)
root.f4x.animate_time = False
root.f4x.speed, root.f4x.start_frame = 1.0, 0
shown("and back", lambda time: time)

def red():
    bpy.context.view_layer.update()
    cloud = next(cloud for cloud in SceneObject(root).clouds if "static" in cloud.name)
    values = np.empty(4 * len(cloud.data.points), np.float32)
    cloud.data.attributes["rgb"].data.foreach_get("color", values)
    return float(values[::4].mean())

noted["red"] = []
for frame, start in ((1, 0), (4, 0), (4, 3)):  # at last at the same frame of the timeline
    root.f4x.start_frame = start
    scaffold.set_frame(bpy.context.scene, frame) if start == 0 else None
    noted["red"].append(red())
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    """A scene whose Gaussians come and go, with edits over time, and images for its frames."""
    scene = fading_scene()
    some = Ids.of(scene.static.ids[:100])
    edits = (
        Recolour(some, (0.9, 0.1, 0.1), frames=(1.0, 2.0)),
        Opacity(Moving(), 0.2, frames=(0.0, 5.0), ease="linear"),
        Delete(Ids.of(scene.static.ids[100:]), frames=(4.0, None)),
    )
    write_scene(with_operations(scene, *edits), tmp_path / "scene.f4x")
    (tmp_path / "images").mkdir()
    for index in range(6):
        cv2.imwrite(str(tmp_path / "images" / f"{index:03d}.png"), np.full((40, 64, 3), 40 * index, np.uint8))
    return tmp_path


def test_pictures_are_those_of_the_clip_frame_that_time_says(folder):
    noted, found = perform(folder, HEAD + f"TIMES = {TIMES}\n" + PICTURES)
    labels = {label.rpartition(" ")[0] for label in found} - {"plain"}
    assert labels == {"start", "speed", "as before", "reverse", "driven", "still", "and back"}
    for label in labels:
        for time in TIMES:
            plain, other = found[f"plain {time}"].astype(int), found[f"{label} {time}"].astype(int)
            assert np.abs(plain - other).max() <= 1, (label, time)
            assert noted[f"{label} {time}"] == noted[f"plain {time}"], (label, time)
    edited, plain, edited_again = noted["red"]
    assert edited > plain + 0.1 and edited_again == pytest.approx(edited)
    size, near = noted["axes"]
    assert size < near  # the clip's first camera is at the root
    assert noted["plain 2.5"][:2] == [2.5, 0]
    pictures = [found[f"plain {time}"].astype(int) for time in TIMES]
    assert all(np.abs(a - b).max() > 20 for a, b in pairwise(pictures))


MOTION = """
def note(label, root, frame_of):
    for time in (0.0, 1.0, 3.0, 4.0):
        scaffold.set_frame(bpy.context.scene, frame_of(time))
        arrays[f"{label} {time}"] = values(next(item for item in bpy.data.objects if item.name.endswith(" dynamic")))

def session(label, frame_of, prepare):
    root = fresh()
    scaffold.layer_of(root).hide_viewport = False
    prepare(root)
    nodes = scaffold.nodes_of(root)
    bpy.context.view_layer.objects.active = nodes[2]
    nodes[2].select_set(True)
    bpy.ops.f4x.write_motion()
    noted[f"{label} untouched"] = len(SceneObject(root).stack)
    scaffold.set_frame(bpy.context.scene, frame_of(3))
    if clip_time.follows_timeline(root):
        bpy.ops.f4x.grab_nodes(offset=(0.3, 0.2, 0.1), reach=2.0, hold="AROUND", frames=1)
    else:
        noted["refused"] = bpy.ops.f4x.grab_nodes.poll()
        root.f4x.animate_time = False
        scaffold.set_frame(bpy.context.scene, 3)
        bpy.ops.f4x.grab_nodes(offset=(0.3, 0.2, 0.1), reach=2.0, hold="AROUND", frames=1)
        root.f4x.animate_time = True
    note(f"{label} grabbed", root, frame_of)
    bpy.ops.f4x.add_handles(count=2)
    note(f"{label} handles", root, frame_of)
    bpy.ops.f4x.write_motion()
    noted[f"{label} written"] = [SceneObject(root).stack.edits[-1].operation.times, len(SceneObject(root).stack)]
    bpy.ops.f4x.history(how="REMOVE", edit_id=SceneObject(root).stack.edits[-1].id)
    note(f"{label} taken back", root, frame_of)

def shift(root):
    root.f4x.start_frame, root.f4x.speed = 1001, 0.8

def freeze(root):
    root.f4x.animate_time = True
    for key in clip_time._time_curve(root).keyframe_points:
        key.co[0] *= 2

root = fresh()
node = scaffold.nodes_of(root)[2]
data = node.animation_data
strip = data.nla_tracks.new().strips.new("pushed down", 0, data.action)
strip.action_slot = data.action_slot
data.action = None
for label, frame in (("before", 3), ("after", 1001 + 3 / 0.8)):
    scaffold.set_frame(bpy.context.scene, frame)
    arrays["strip " + label] = np.array(node.location)
    shift(root)
session("plain", lambda time: time, lambda root: None)
session("shifted", lambda time: 1001 + time / 0.8, shift)
session("slow", lambda time: 2 * time, freeze)
"""


def test_motion_is_edited_and_written_back_at_clip_frames(folder):
    noted, found = perform(folder, HEAD + MOTION)
    assert noted.pop("refused") is False
    assert np.abs(found["strip before"] - found["strip after"]).max() < 1e-6
    for label in ("shifted", "slow"):
        for step in ("grabbed", "handles", "taken back"):
            for time in (0.0, 1.0, 3.0, 4.0):
                plain, other = found[f"plain {step} {time}"], found[f"{label} {step} {time}"]
                assert np.abs(plain - other).max() < 2e-5, (label, step, time)
        assert noted[f"{label} untouched"] == noted["plain untouched"] == 3  # the edits of the file, and no motion
        assert noted[f"{label} written"] == noted["plain written"]
    assert np.abs(found["plain grabbed 3.0"] - found["plain taken back 3.0"]).max() > 0.1


SHOTS = """
from bpy import context, ops

def moment(label, frame, *names):
    context.scene.frame_set(frame)
    shots = [SceneObject(bpy.data.objects[name]) for name in names]
    noted[label] = [[shot.frame, motion_edits.unwritten(shot)] for shot in shots]
    for shot in shots:
        (camera,) = [item for item in shot.root.children if item.type == "CAMERA"]
        assert camera.data.background_images[0].image_user.frame_offset == shot.frame - 1, (label, shot.name)

bpy.ops.wm.read_factory_settings(use_empty=True)
context.scene.render.fps, context.scene.frame_end = 30, 77
roots = [import_scene(folder / "scene.f4x", set_up_render=False, clip=folder / "images") for _ in range(2)]
one, two = names = [root.name for root in roots]
noted["rates"] = [root.f4x.speed for root in roots]
roots[1].f4x.start_frame, roots[1].f4x.speed = 50, 2.0
moment("5", 5, *names)
moment("51", 51, *names)

for item in [roots[0], *roots[0].children_recursive]:
    item.select_set(True)
context.view_layer.objects.active = roots[0]
ops.object.duplicate()
copy = next(shot.root for shot in SceneObject.among(context.scene.objects) if shot.root not in roots)
names.append(copy.name)
context.view_layer.update()
copy.f4x.start_frame = 51
moment("copy at 51", 51, *names)
moment("copy at 5", 5, *names)

ops.ed.undo_push(message="before")
bpy.data.objects[one].f4x.start_frame = 20
ops.ed.undo_push(message="start")
ops.ed.undo()
noted["undone start"] = bpy.data.objects[one].f4x.start_frame
moment("undone", 5, *names)
ops.ed.redo()
noted["redone start"] = bpy.data.objects[one].f4x.start_frame
moment("redone", 25, *names)

ops.object.select_all(action="DESELECT")
context.view_layer.objects.active = bpy.data.objects[one]
ops.f4x.plan(sentence="make everything red from frame 2 to 3"); ops.f4x.apply_plan()
ops.f4x.plan(sentence="hide everything from now on"); ops.f4x.apply_plan()
noted["said"] = [list(edit.operation.frames or ()) for edit in SceneObject(bpy.data.objects[one]).stack.edits[-2:]]
noted["range"] = [context.scene.render.fps, context.scene.frame_end]

bpy.data.objects[one]["f4x_start"] = 40.0  # as in Custom Properties
context.view_layer.update()
moment("by hand", 45, *names)
ops.wm.save_as_mainfile(filepath=str(folder / "shots.blend"))
ops.wm.open_mainfile(filepath=str(folder / "shots.blend"))
moment("opened", 45, *names)

ops.f4x.plan(sentence="slow everything to half")
noted["answer"] = SceneObject(bpy.data.objects[one]).state.answer
context.scene.frame_end = 46
ops.f4x.slow_clip(speed=SceneObject(bpy.data.objects[one]).state.slower)
noted["slowed"] = [context.scene.frame_end, bpy.data.objects[one].f4x.speed]
moment("slow", 50, *names)
"""


def test_two_shots_of_different_starts_and_rates_play_in_one_file(folder):
    noted, _ = perform(folder, HEAD + SHOTS)
    settings = {
        name: noted.pop(name) for name in ("rates", "undone start", "redone start", "said", "range", "answer", "slowed")
    }
    assert settings["rates"] == [pytest.approx(0.8)] * 2
    assert settings["undone start"] == 0 and settings["redone start"] == 20
    assert settings["said"] == [[2, 3], [4, None]]
    assert settings["range"] == [30, 77]
    assert settings["answer"].endswith(
        "Speed 0.5 in the panel Motion, or the button below, shows all of it, with a slower camera."
    )
    assert settings["slowed"] == [52, pytest.approx(0.4)]
    expected = {
        "5": [4, 0], "51": [5, 2], "copy at 51": [5, 2, 0], "copy at 5": [4, 0, 0],
        "undone": [4, 0, 0], "redone": [4, 0, 0], "by hand": [4, 0, 0], "opened": [4, 0, 0],
        "slow": [4, 0, 0],
    }  # fmt: skip
    assert {label: [time for time, _ in shots] for label, shots in noted.items()} == expected
    assert not any(unwritten for shots in noted.values() for _, unwritten in shots)
