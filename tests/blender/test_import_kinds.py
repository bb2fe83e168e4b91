"""What File > Import takes: splats of other programs, sequences, scenes with edits; the clip behind the camera; refusals."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from labelled_scene import labelled_scene
from PIL import Image

from f4x_core.clip.video import write_video
from f4x_core.edit.apply import base_of, edited, with_operations
from f4x_core.edit.operations import Delete, Duplicate, Opacity, Recolour, Rekey, Transform
from f4x_core.edit.selects import Ids, Moving
from f4x_core.native.library import open_library
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export

from .artist import perform
from .tiny_scene import CLIP, STATIC, tiny_scene

ROOT = Path(__file__).resolve().parents[2]

CHILD = """
import shutil
import feature4x.addon.io.sequence as sequence
from feature4x.addon.render.evaluated import stage
clip, scene = int(sys.argv[3]), bpy.context.scene

def fresh():
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    for collection in list(bpy.data.collections):
        bpy.data.collections.remove(collection)
    for kind in (bpy.data.images, bpy.data.cameras, bpy.data.pointclouds):
        for block in list(kind):
            kind.remove(block)

def load(name, **options):
    fresh()
    try:
        bpy.ops.f4x.import_scene(filepath=str(folder / name), **options)
    except RuntimeError as error:
        return str(error), len(bpy.data.objects) + len(bpy.data.collections)
    return bpy.context.object

for name in ("frame.ply", "frame.splat", "frame.spz", "frame.glb", "renamed.dat"):
    root = load(name)
    cloud = next(item for item in root.children if item.type == "POINTCLOUD" and len(item.data.points))
    arrays[name] = values(cloud, "position")
    arrays[name + " in the world"] = arrays[name] @ np.array(cloud.matrix_world)[:3, :3].T
    arrays[name + " scale"] = values(cloud, "scale")
    arrays[name + " radiance"] = values(cloud, "radiance:base")
    noted[name] = [root["f4x_path"], scene.camera.name, "f4x_source" in root]

for label, options in (("all", {}), ("step", {"step": 2}), ("alone", {"sequence": False})):
    root = load("walk_0001.ply", **options)
    clouds = [item for item in root.children if item.type == "POINTCLOUD" and len(item.data.points)]
    noted[f"sequence {label}"] = [[item.name for item in clouds], scene.frame_start, scene.frame_end]
    for when, start in (("seen", 0), ("later", 10)):
        root.f4x.start_frame = start
        for frame in range(3):
            scene.frame_set(start + frame)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            seen = [i.object.name for i in depsgraph.object_instances if i.object.type == "POINTCLOUD"]
            noted[f"{when} {label} {frame}"] = [seen, sum(len(c.means) for c in stage(depsgraph)[0])]
noted["broken frame"] = load("torn_0001.ply")
for name in ("mesh.ply", "mesh.glb", "absent.f4x", "film.mp4", "pictures"):
    noted[name] = load(name)

sequence.MAX_BYTES = 3000
noted["too large"] = load("walk_0001.ply")

root = load("edited.f4x")
parts = [item for item in root.children if item.type == "POINTCLOUD" and len(item.data.points)]
for frame in range(clip):
    scene.frame_set(frame)
    for name in ("gid", "position", "radiance:base"):
        arrays[f"edited/{frame}/{name}"] = np.concatenate([values(item, name) for item in parts])

def background():
    pictures = scene.camera.data.background_images
    if not pictures:
        return None
    paths = []
    for frame in range(clip):
        scene.frame_set(frame)
        scene.frame_set(frame)  # Blender reads a keyed offset before or after it moves on, by chance: now it stands
        user = pictures[0].image_user
        paths.append(Path(bpy.path.abspath(pictures[0].image.filepath_from_user(image_user=user))).name)
    return [pictures[0].image.source, paths]

load("own.f4x")
noted["own clip"] = background()
noted["own clip fills"] = scene.camera.data.background_images[0].frame_method
load("barred.f4x")
noted["barred clip"] = background()
noted["barred clip fills"] = scene.camera.data.background_images[0].frame_method
load("own.f4x")
noted["hidden by"] = None if scene.camera.data.show_background_images else scene.render.engine
for name in ("later", "skipping", "too short"):
    load(f"{name}.f4x")
    noted[name] = background()
load("edited.f4x")
noted["no clip"] = background()
load("edited.f4x", clip=str(folder / "pictures"))
noted["chosen"] = background()
load("own.f4x", clip=str(folder / "film.mp4"))
noted["film"] = background()
load("edited.f4x")
noted["not kept"] = background()
noted["bad clip"] = load("own.f4x", clip=str(folder / "frame.ply"))
load("longer.f4x")
noted["other count"] = background()
bpy.ops.f4x.choose_clip(filepath=str(folder / "pictures" / "00007.png"))
noted["button"] = background()
noted["shown by the button"] = scene.camera.data.show_background_images

(folder / "before").mkdir()
shutil.copy(folder / "edited.f4x", folder / "before/scene.f4x")
load("before/scene.f4x")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "before/scene.blend"))
(folder / "before").rename(folder / "after")
bpy.ops.wm.open_mainfile(filepath=str(folder / "after/scene.blend"))
scene_object = SceneObject.of(bpy.context.object)
noted["moved"] = [str(scene_object.path), len(scene_object.base.ids)]
for name in ("other", "edited"):
    try:
        bpy.ops.f4x.find_scene(filepath=str(folder / f"{name}.f4x"))
    except RuntimeError as error:
        noted["other scene"] = str(error)
noted["found"] = str(scene_object.path)
"""


def edited_scene():
    """The tiny scene with edits of every kind that Blender shows in its own way."""
    scene = tiny_scene()
    curves, knots = scene.scaffold, [0, 2, 4]
    key = Rekey.of(
        curves.ids[[1, 5]],
        curves.times[knots],
        curves.xyz[knots][:, [1, 5]] + np.float32(0.2),
        curves.quat[knots][:, [1, 5]],
    )
    ids = [Ids.of(np.arange(*span)) for span in ((0, 20), (60, 120), (200, 230), (300, 310))]
    return with_operations(
        scene,
        key,
        Recolour(Moving(), (1, 0, 0)),
        Opacity(ids[0], 0.5, (2, 4)),
        Transform(ids[1], (1, 0, 0)),
        Duplicate(ids[2], (0, 1, 0)),
        Delete(ids[3]),
    )


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    scene = tiny_scene()
    write_scene(labelled_scene(), folder / "other.f4x")
    export(scene, folder / "frame.ply", [2.0])
    (folder / "renamed.dat").write_bytes((folder / "frame.ply").read_bytes())
    for kind, ending in (("splat", "splat"), ("spz", "spz"), ("gltf", "glb")):
        export(scene, folder / f"frame.{ending}", [2.0], kind)
    trimesh.creation.box().export(folder / "mesh.glb")
    for number in (1, 2, 3):
        for name in ("walk", "torn"):
            export(scene, folder / f"{name}_{number:04d}.ply", [float(number)])
    (folder / "torn_0002.ply").write_bytes((folder / "torn_0002.ply").read_bytes()[:-100])
    (folder / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    )
    write_scene(base_of(edited_scene()), folder / "edited.f4x")
    (folder / "pictures").mkdir()
    for frame in range(CLIP):
        Image.new("RGB", (96, 64), (30 * frame, 0, 0)).save(folder / "pictures" / f"{7 + frame:05d}.png")
    write_video(folder / "film.mp4", np.zeros((CLIP, 64, 96, 3), np.uint8), 24)
    for name, source in (("own", "pictures"), ("longer", "more")):
        write_scene(replace(scene, provenance={"source": source}), folder / f"{name}.f4x")
    cut = {"left": 0, "top": 8, "right": 96, "bottom": 56, "width": 96, "height": 64}
    write_scene(replace(scene, provenance={"source": "pictures", "picture": cut}), folder / "barred.f4x")
    for name, frames in (
        ("later", f"2:{2 + CLIP}:1"),
        ("skipping", f"1:{2 * CLIP}:2"),
        ("too short", f"9:{9 + CLIP}:1"),
    ):
        write_scene(replace(scene, provenance={"source": "more", "frames": frames}), folder / f"{name}.f4x")
    (folder / "more").mkdir()
    for frame in range(2 * CLIP):
        Image.new("RGB", (96, 64)).save(folder / "more" / f"{frame:05d}.png")
    noted, arrays = perform(folder, CHILD, CLIP)
    return folder, arrays, noted


@pytest.mark.parametrize("name", ["frame.ply", "frame.splat", "frame.spz", "frame.glb", "renamed.dat"])
def test_splats_of_other_programs(imported, name):
    folder, found, told = imported
    np.testing.assert_allclose(found[name], open_any(folder / name).static.means, atol=1e-6)
    source, camera, is_scene = told[name]
    assert source.endswith(name) and camera.startswith(Path(name).stem) and not is_scene


@pytest.mark.parametrize(("name", "place", "size", "light"), [("spz", 2**-19, 0.032, 0.014), ("glb", 1e-6, 1e-6, 1e-6)])
def test_files_whose_y_is_up_are_the_same_gaussians_as_the_ply(imported, name, place, size, light):
    _, found, _ = imported
    for kind in ("", " in the world"):
        np.testing.assert_allclose(found[f"frame.{name}{kind}"], found[f"frame.ply{kind}"], rtol=0, atol=place)
    np.testing.assert_allclose(found[f"frame.{name} scale"], found["frame.ply scale"], rtol=size)
    np.testing.assert_allclose(found[f"frame.{name} radiance"], found["frame.ply radiance"], rtol=0, atol=light)


def test_a_sequence_plays(imported):
    _, _, told = imported
    names, first, last = told["sequence all"]
    assert names == [f"walk frame {i:05d}" for i in range(3)] and (first, last) == (0, 2)
    count = STATIC + len(tiny_scene().dynamic)
    for frame in range(3):
        assert told[f"seen all {frame}"] == told[f"later all {frame}"] == [[names[frame]], count]


def test_a_sequence_in_steps_and_one_file_of_it(imported):
    _, _, told = imported
    assert told["sequence step"][0] == ["walk frame 00000", "walk frame 00002"]
    assert [told[f"seen step {frame}"][0] for frame in range(3)] == [[f"walk frame {i:05d}"] for i in (0, 0, 2)]
    assert told["sequence alone"][0] == ["walk_0001 static"]


@pytest.mark.parametrize(
    ("name", "words"),
    [("too large", "Step"), ("broken frame", "torn_0002.ply"), ("mesh.ply", "mesh.ply"),
     ("mesh.glb", "without splats"), ("absent.f4x", "no such file"),
     ("film.mp4", "a video"), ("pictures", "a folder of pictures"), ("bad clip", "neither a film nor")],
)  # fmt: skip
def test_what_cannot_be_imported_is_one_sentence_and_leaves_nothing(imported, name, words):
    _, _, told = imported
    sentence, left = told[name]
    assert words in sentence and "Traceback" not in sentence and sentence.count("\n") <= 1
    assert left == 0


@pytest.mark.parametrize("frame", range(CLIP))
def test_edits_come_along(imported, frame):
    folder, found, _ = imported
    posed = edited(read_scene(folder / "edited.f4x")).posed(frame)
    gid = found[f"edited/{frame}/gid"].ravel()
    row = np.array([int(np.flatnonzero(posed.ids == id)[0]) for id in gid])
    assert sorted(gid.tolist()) == sorted(posed.ids[posed.opacities > 0].tolist())
    np.testing.assert_allclose(found[f"edited/{frame}/position"], posed.means[row], atol=1e-5)
    np.testing.assert_allclose(found[f"edited/{frame}/radiance:base"][:, 3], posed.opacities[row], atol=1e-6)


def test_the_clip_behind_the_camera(imported):
    _, _, told = imported
    pictures = ["SEQUENCE", [f"{7 + frame:05d}.png" for frame in range(CLIP)]]
    assert told["own clip"] == pictures and told["chosen"] == pictures
    assert (
        told["barred clip"] == pictures and told["barred clip fills"] == "CROP" and told["own clip fills"] == "STRETCH"
    )
    assert told["no clip"] is None
    assert told["film"] == ["MOVIE", ["film.mp4"] * CLIP]
    assert told["hidden by"] == ("FEATURE4X" if open_library()[0] is not None else None)


def test_a_clip_is_for_one_import(imported):
    assert imported[2]["not kept"] is None


def test_drops_have_the_properties_that_blender_fills():
    code = "import sys; sys.path.insert(0, sys.argv[1] + '/scripts'); import bpy, door, os; door.load_extension().register();"
    code += "names = bpy.ops.f4x.import_scene.get_rna_type().properties.keys();"
    code += "print(sorted({'files', 'directory', 'filepath'} & {*names}), flush=True); door.end()"
    done = subprocess.run([sys.executable, "-c", code, str(ROOT)], capture_output=True, text=True, timeout=120)
    assert "['directory', 'filepath', 'files']" in done.stdout, done.stderr


def test_a_scene_file_that_was_moved_with_its_blend_is_found(imported):
    folder, _, told = imported
    assert told["moved"] == [str(folder / "after/scene.f4x"), len(read_scene(folder / "edited.f4x").ids)]
    assert "no longer holds the Gaussians" in told["other scene"] and told["found"] == str(folder / "edited.f4x")


def test_the_frames_that_a_fit_took_of_its_clip(imported):
    _, _, told = imported
    for name, first, step in (("later", 2, 1), ("skipping", 1, 2)):
        assert told[name] == ["SEQUENCE", [f"{first + step * frame:05d}.png" for frame in range(CLIP)]]
    assert told["too short"] is None


def test_a_clip_with_another_number_of_pictures_is_shown_only_when_asked(imported):
    _, _, told = imported
    assert told["other count"] is None
    assert told["button"] == told["own clip"]
    assert told["shown by the button"]
