"""The doors without a window: what they leave, what they say in JSON, and how they end."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene

from f4x_core.edit.apply import open_scene, with_operations
from f4x_core.edit.operations import Recolour
from f4x_core.edit.resolve import EditorState, resolve
from f4x_core.edit.selects import Text
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors.synthetic import read_passes
from f4x_core.query.prompts import select_by_text
from f4x_core.query.selection import Selection
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.view import render

pytest.importorskip("OpenEXR")
cv2 = pytest.importorskip("cv2")
SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
DOORS = ("import_scene.py", "query_scene.py", "edit_scene.py", "render_scene.py", "make_truth.py", "synthetic_clip.py")

# A film of two boxes and a floor: one box moves behind the other; the lens is shifted, pixels are not square.
SHOT = f"import sys; sys.path.insert(0, {str(SCRIPTS)!r}); import door\n"
SHOT += """
import bpy, math
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
def box(name, place, size):
    bpy.ops.mesh.primitive_cube_add(size=1, location=place)
    item = bpy.context.object
    item.name, item.scale = name, size
    return item
box("floor", (0, 0, -0.5), (8, 8, 0.1))
box("post", (0.3, -1, 0.3), (0.4, 0.2, 1.6))
mover = box("mover", (-0.8, 0, 0.3), (0.8, 0.6, 1.0))
for frame, x in ((9, -0.9), (14, 0.6)):
    mover.location.x = x
    mover.keyframe_insert("location", frame=frame)
camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
camera.location, camera.rotation_euler = (0, -5, 1), (math.radians(82), 0, 0)
camera.data.shift_x, camera.data.sensor_fit = 0.05, "VERTICAL"
scene.collection.objects.link(camera)
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy = 3
scene.collection.objects.link(sun)
scene.render.resolution_x, scene.render.resolution_y, scene.render.pixel_aspect_x = 80, 48, 1.2
scene.frame_start, scene.frame_end = 10, 13
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
door.end()
"""

ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed .blend."""
# What a person finds who opens a .blend and presses F12.
F12 = """
import sys; sys.path.insert(0, sys.argv[1])
import door; door.end_at_errors()
import bpy, json
door.start_blender()
bpy.ops.wm.open_mainfile(filepath=sys.argv[2])
scene = bpy.context.scene
scene.render.filepath = sys.argv[3]
bpy.ops.render.render(write_still=True)
space = next(area.spaces.active for area in bpy.context.window.screen.areas if area.type == "VIEW_3D")
print(json.dumps([scene.render.engine, scene.camera.name, space.shading.type, space.region_3d.view_perspective]))
door.end()
"""


def python(*command: str) -> subprocess.CompletedProcess:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True, env=environment)


def run(name: str, *arguments) -> dict:
    """What a door that ends well says last."""
    done = python(SCRIPTS / name, *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def refused(name: str, *arguments) -> str:
    done = python(SCRIPTS / name, *arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    sentence = json.loads(done.stdout.splitlines()[-1])["error"]
    assert done.stderr.strip() == f"error: {sentence}"
    return sentence


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "labelled.f4x"
    write_scene(labelled_scene(), path)
    return path


def test_every_door_explains_itself():
    for name in DOORS:
        done = python(SCRIPTS / name, "--help")
        assert done.returncode == 0 and name in done.stdout and done.stderr == ""
    assert python(SCRIPTS / "query_scene.py").returncode == 2  # argparse: nothing was given


def test_query_selects_as_the_core_does(scene, tmp_path):
    result = run(
        "query_scene.py", scene, "--text", "square", "--selection", tmp_path / "s.json", "--blend", tmp_path / "s.blend"
    )
    found = select_by_text(read_scene(scene), ["square"])
    assert 0 < result["chosen"] == result["points"] == found.chosen.sum() < result["gaussians"] == len(found.ids)
    stored = Selection.from_json(json.loads((tmp_path / "s.json").read_text()))
    assert np.array_equal(stored.chosen_ids, found.chosen_ids)
    assert (tmp_path / "s.blend").stat().st_size > 0
    assert "lacks 'elephant'" in refused("query_scene.py", scene, "--text", "elephant")
    assert "end it in .blend" in refused("import_scene.py", scene, tmp_path / "out.txt")


def test_what_import_leaves_is_seen_and_rendered_as_the_core_draws_it(scene, tmp_path):
    """F12 in the .blend needs no settings first: the engine, the clip's camera and the viewport are those of a window's import."""
    run("import_scene.py", scene, tmp_path / "shot.blend")
    assert (tmp_path / "shot.blend").read_bytes()[:4] == ZSTD
    done = python("-c", F12, SCRIPTS, tmp_path / "shot.blend", tmp_path / "f12.png")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == ["FEATURE4X", "labelled camera", "RENDERED", "CAMERA"]
    clip = read_scene(scene)
    picture = cv2.imread(str(tmp_path / "f12.png"))[..., ::-1]
    assert np.abs(picture / 255 - render(clip, clip.cameras[0], 0.0)["rgb"]).max() < 1.01 / 255


def test_edit_is_that_of_the_command_line(scene, tmp_path):
    result = run("edit_scene.py", scene, "--say", "make the square green", "-o", tmp_path / "green.f4x")
    [line] = result["edits"]
    assert line.startswith("make the square green (") and line.endswith("% of the scene's Gaussians)")
    assert result["gaussians"][0] > 0
    done = python("-m", "f4x_core", "edit", scene, "--say", "make the square green", "-o", tmp_path / "core.f4x")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "green.f4x").read_bytes() == (tmp_path / "core.f4x").read_bytes()
    (tmp_path / "ops.json").write_text(json.dumps([{"op": "recolour", "select": {"by": "moving"}, "rgb": [0, 1, 0]}]))
    result = run(
        "edit_scene.py", tmp_path / "green.f4x", "--ops", tmp_path / "ops.json", "--blend", tmp_path / "g.blend"
    )
    assert len(open_scene(tmp_path / "green.f4x").edits) == 2 and (tmp_path / "g.blend").exists()
    assert "sqare" in refused("edit_scene.py", scene, "--say", "make the sqare green")


def test_render_is_the_cores_picture(scene, tmp_path):
    red = resolve(read_scene(scene), Recolour(Text(("square",)), (0.0, 1.0, 0.0)), EditorState())
    edited = with_operations(read_scene(scene), red)
    write_scene(edited, tmp_path / "edited.f4x")
    result = run("render_scene.py", tmp_path / "edited.f4x", "-o", tmp_path / "out", "--frames", "1:5:3", "--exr")
    assert result["frames"] == [1, 4] and result["files"] == ["00001.exr", "00001.png", "00004.exr", "00004.png"]
    again = open_scene(tmp_path / "edited.f4x")
    expected = render(again, again.cameras[4], 4.0, ("rgb", "depth"))
    picture = cv2.imread(str(tmp_path / "out" / "00004.png"))[..., ::-1]
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(picture / 255 - expected["rgb"]).max() < 1.01 / 255
    assert "Alpha" in read_passes(tmp_path / "out" / "00004.exr")
    assert f"0 to {FRAMES - 1}" in refused(
        "render_scene.py", tmp_path / "edited.f4x", "-o", tmp_path / "o", "--frames", "3:99"
    )


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("truth")
    done = python("-c", SHOT, folder / "shot.blend")
    assert done.returncode == 0, done.stderr
    result = run(
        "make_truth.py", folder / "shot.blend", folder / "out", "--camera", "eye", "--samples", "1", "--tracks", "60"
    )
    return folder / "out", result


def test_truth_reprojects(truth):
    folder, result = truth
    facts = json.loads((folder / "truth.json").read_text())
    cameras = CameraPath.from_json(facts["cameras"])
    assert result["moving"] == ["mover"] and result["frames"] == len(cameras) == 4
    assert (cameras.width, cameras.height) == (80, 48) and np.array_equal(cameras.times, range(4))
    for t, camera in enumerate(cameras):
        passes = read_passes(folder / "truth" / f"{t:05d}.exr")
        seen = passes["Depth"] < 1e9
        pixels, depth = camera.project(passes["Position"].astype(float))
        assert np.abs(pixels - camera.pixel_grid())[seen].max() < 0.01
        assert np.abs(depth - passes["Depth"])[seen].max() < 1e-4
        mask = cv2.imread(str(folder / "masks" / f"{t:05d}.png"), cv2.IMREAD_GRAYSCALE) > 127
        assert 0.01 < mask.mean() < 0.3 and (mask != (passes["Object Index"] == 2)).mean() < 0.005
        assert (folder / "images" / f"{t:05d}.png").is_file()


def test_truth_tracks_follow_the_flow_and_know_when_they_are_hidden(truth):
    folder, result = truth
    tracks = np.load(folder / "tracks.npz")
    xy, visible, moving = tracks["tracks"], tracks["visible"], tracks["moving"]
    assert xy.shape == (4, result["tracks"], 2) and result["tracks"] == 60 and 10 < moving.sum() < 50
    assert not visible[:, moving].all() and visible.any(0).all()  # some go behind the post, none is never seen
    travelled = np.abs(xy[-1] - xy[0]).max(1)
    assert travelled[~moving].max() < 1e-3 and travelled[moving].min() > 2
    passes = read_passes(folder / "truth" / "00001.exr")
    both = np.flatnonzero(visible[1] & visible[2])
    column, row = np.floor(xy[1, both]).astype(int).T
    flow = np.stack([-passes["Vector"][row, column, 2], passes["Vector"][row, column, 3]], -1)
    error = np.linalg.norm(flow - (xy[2] - xy[1])[both], axis=1)
    print(f"flow against tracks: median {np.median(error):.4f} px, 80 % below {np.quantile(error, 0.8):.4f} px")
    assert np.quantile(error, 0.8) < 0.05  # pixels on an edge show another surface than their middle


def test_truth_refuses_in_one_sentence(truth, tmp_path):
    shot = truth[0].parent / "shot.blend"
    assert "there: eye" in refused("make_truth.py", shot, tmp_path, "--camera", "nobody")
    assert "no such object" in refused("make_truth.py", shot, tmp_path, "--camera", "eye", "--moving", "ghost")
    broken = tmp_path / "broken.blend"
    broken.write_bytes(b"no blend")
    assert "broken.blend" in refused("make_truth.py", broken, tmp_path / "out")
