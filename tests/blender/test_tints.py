"""Colors over time in Blender: attributes and geometry nodes show those of the core at any clip time, and a switch stops them."""

import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
from random_scene import random_scene

from f4x_core.edit.apply import edited, with_operations
from f4x_core.edit.operations import Delete, Duplicate, Freeze, Recolour, Transform
from f4x_core.edit.selects import Ids, Moving, Not
from f4x_core.geometry.spherical_harmonics import rgb_from_dc
from f4x_core.scene import Scene, read_scene, write_scene
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.tints import with_tints, without_tints
from f4x_core.scene.view import render

from .artist import ROOT, perform

KNOTS = np.array([0.0, 1.0, 3.0, 5.0])
TIMES = (0.0, 0.25, 2.0, 4.5, 5.0)
M, S = Moving(), Not(Moving())
EDITS = {
    "nothing": [],
    "background moved": [Transform(S, (0.1, 0, 0))],
    "mover moved": [Transform(M, (0.1, 0, 0)), Delete(Ids.of(np.array([3, 35])))],
    "multiplied": [Recolour(S, (1, 0.5, 0), "multiply", 1.0)],
    "a stop up": [Recolour(S, (2, 2, 2), "light", 1.0)],
    "red for a while": [Recolour(M, (1, 0, 0), "multiply", 0.7, frames=(2, 5))],
    "copies": [Duplicate(S, (1, 0, 0), count=2), Recolour(S, (1, 0.2, 0.3), "multiply", 1.0)],
    "later copies": [Duplicate(S, (1, 0, 0), time_shift=1.5)],
    "background stopped": [Freeze(S, 2.5)],
    "mover stopped": [Freeze(M, 2.5)],
}  # fmt: skip

FADING = {"nothing", "mover moved"}
"""Where Gaussians also come and go, what is drawn apart is drawn at every frame."""

READ = """
def colors(item):
    "Id, degree 0 and opacity, and linear light of each point."
    data = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    if "gid" not in data.attributes:  # all points are gone
        return np.zeros((0, 9), np.float32)
    flat, parts = len(data.points), []
    for name, width in (("gid", 1), ("radiance:base", 4), ("rgb", 4)):
        attribute = data.attributes[name]
        values = np.empty(flat * width, np.float32 if width > 1 else np.int32)
        attribute.data.foreach_get({"INT": "value", "FLOAT4": "vector"}.get(attribute.data_type, "color"), values)
        parts.append(values.reshape(flat, width))
    return np.concatenate(parts, 1)

def note(label):
    bpy.context.view_layer.update()
    clouds = [item for item in bpy.data.objects if item.type == "POINTCLOUD"]
    arrays[label] = np.concatenate([colors(item) for item in clouds])
"""
PLAY = """
from feature4x.addon.rig import scaffold

def play(label, frame_of=lambda time: time):
    for time in TIMES:
        scaffold.set_frame(bpy.context.scene, frame_of(time))
        note(f"{label}/{time}")

def fresh(name):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ops.import_scene(filepath=str(folder / name))
    bpy.context.scene.render.engine = "FEATURE4X"
    return root()
"""


def tinted_scene(fades: bool, seed: int = 3) -> Scene:
    """A random scene with random tints at `KNOTS`; `fades`: its background comes and goes."""
    scene, rng = random_scene(seed), np.random.default_rng(seed)
    if fades:
        span = np.sort(rng.integers(-2, 8, (len(scene.static), 4)), axis=1).astype(np.float32)
        scene = replace(scene, static=replace(scene.static, span=span))
    return with_tints(scene, KNOTS, rng.integers(-127, 128, (len(scene.ids), len(KNOTS), 3)).astype(np.int8))


def assert_colors(found: np.ndarray, scene: Scene, time: float, what: str) -> None:
    """The colors `found` of points are those of a scene with its edits at a clip time, in all of its Gaussians."""
    posed = edited(scene).posed(time)
    rows = np.searchsorted(posed.ids, found[:, 0], sorter=(order := np.argsort(posed.ids)))
    rows = order[rows]
    np.testing.assert_array_equal(np.sort(rows), np.flatnonzero(~edited(scene).gone), what)
    dc, alpha = posed.sh[rows, 0], posed.opacities[rows]
    np.testing.assert_allclose(found[:, 1:5], np.column_stack([dc, alpha]), atol=1e-3, err_msg=what)
    light = linear_from_srgb(rgb_from_dc(dc).clip(0, 1))
    np.testing.assert_allclose(found[:, 5:], np.column_stack([light, alpha]), atol=1e-3, err_msg=what)


def test_the_colors_of_edited_scenes_are_the_cores_at_any_time_and_steady_when_switched_off(tmp_path):
    scenes = {name: with_operations(tinted_scene(name in FADING), *operations) for name, operations in EDITS.items()}
    for name, scene in scenes.items():
        write_scene(scene, tmp_path / f"{name}.f4x")
    script = f"""
for name in {list(EDITS)}:
    state = fresh(name + ".f4x").f4x
    play(name + "/on")
    noted[name] = state.colors_over_time
    state.colors_over_time = False
    note(name + "/at once")
    play(name + "/off")
"""
    noted, arrays = perform(tmp_path, READ + PLAY + f"TIMES = {TIMES}\n" + script)
    assert set(noted.values()) == {True}
    for name, scene in scenes.items():
        for time in TIMES:
            assert_colors(arrays[f"{name}/on/{time}"], scene, time, f"{name} at {time}")
            assert_colors(arrays[f"{name}/off/{time}"], without_tints(scene), time, f"{name} at {time}, off")
        assert_colors(arrays[f"{name}/at once"], without_tints(scene), TIMES[-1], name)


def test_they_follow_time_undo_saving_and_points_that_come_back(tmp_path):
    scene = tinted_scene(fades=True)
    write_scene(scene, tmp_path / "scene.f4x")
    write_scene(random_scene(3), tmp_path / "plain.f4x")
    script = """
from feature4x.addon.scene import clip_time, tints
from feature4x.addon.operators import point_edits
from feature4x.addon.common.point_cloud import write_attribute
fresh("plain.f4x")
noted["plain"] = tints.are_there(scene_object().clouds)
state = fresh("scene.f4x").f4x
state.start_frame, state.speed = 101, 0.5
play("shifted", lambda time: 101 + time / 0.5)
state.animate_time = True
for key in clip_time._time_curve(root()).keyframe_points:
    key.co[1] = 5 - key.co[1]
play("backwards", lambda time: 101 + (5 - time) / 0.5)
state.animate_time = False
state.start_frame, state.speed = 0, 1
push("before")
state.colors_over_time = False
push("off")
bpy.ops.ed.undo()
noted["undone"] = root().f4x.colors_over_time
play("undone")
bpy.ops.ed.redo()
noted["redone"] = root().f4x.colors_over_time
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "off.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "off.blend"))
noted["opened"] = root().f4x.colors_over_time
play("off")
root().f4x.colors_over_time = True
static = next(item for item in bpy.data.objects if item.name.endswith(" static"))
static.data = point_edits._spare_data(static.data, 5)
write_attribute(static.data, "gid", "INT", scene_object().base.static.ids[:5])  # all others were deleted in Edit Mode
point_edits.put_back(scene_object())
play("put back")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "on.blend"))
for time in (0, 3):
    bpy.context.scene.frame_set(time)
    image = bpy.context.scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, bpy.context.scene.render.filepath = "PNG", str(folder / f"{time}.png")
    bpy.ops.render.render(write_still=True)
scene_object().write(f4x_score=("FLOAT", np.linspace(0, 1, 50, dtype=np.float32)))
root().f4x.show_score = True
play("score")
scene_object().save_as(folder / "saved.f4x")
"""
    noted, arrays = perform(tmp_path, READ + PLAY + f"TIMES = {TIMES}\n" + script)
    assert noted == {"plain": False, "undone": True, "redone": False, "opened": False}
    for time in TIMES:
        for label in ("shifted", "backwards", "undone", "put back"):
            assert_colors(arrays[f"{label}/{time}"], scene, time, f"{label} at {time}")
        assert_colors(arrays[f"off/{time}"], without_tints(scene), time, "off")
        np.testing.assert_array_equal(arrays[f"score/{time}"][:, 1:4], arrays["score/0.0"][:, 1:4])
    shown = read_scene(tmp_path / "saved.f4x")
    for time in (0, 3):
        picture = cv2.imread(str(tmp_path / f"{time}.png"))[..., ::-1] / 255
        exact = render(shown, shown.cameras.at(float(time)), float(time), ("rgb",))["rgb"]
        assert np.abs(picture - exact.clip(0, 1)).max() < 2 / 255
    play_alone = f"""
import sys
sys.path.insert(0, {str(ROOT / "scripts")!r})
import door, bpy
import numpy as np
arrays = {{}}
{READ}
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
for time in {TIMES}:
    bpy.context.scene.frame_set(int(time), subframe=time % 1)
    note(str(time))
np.savez(sys.argv[2], **arrays)
door.end()
"""
    subprocess.run([sys.executable, "-c", play_alone, tmp_path / "on.blend", tmp_path / "alone.npz"], check=True)
    for time, found in np.load(tmp_path / "alone.npz").items():
        assert_colors(found, scene, float(time), f"without the extension at {time}")
