"""The engine FEATURE4X: untouched it gives the core's own picture; what is done in Blender shows in it.

One child renders everything; the tests look at the files it leaves.
"""

from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
from labelled_scene import labelled_scene
from random_scene import HEIGHT, WIDTH, random_scene

from f4x_core.features.pca import fit_pca
from f4x_core.geometry.camera import Camera
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.view import over_background, render

from .artist import perform

FRAME = 3
WORLD = (0.2, 0.05, 0.4)  # linear
# how the camera looks: settings of its data, then of the render
CAMERAS = {
    "horizontal": ({"sensor_fit": "HORIZONTAL", "shift_x": 0.1, "shift_y": -0.05}, {"resolution_percentage": 50}),
    "vertical": ({"sensor_fit": "VERTICAL", "sensor_height": 20.0, "shift_y": 0.1}, {}),
    "portrait": ({"sensor_fit": "AUTO", "shift_x": 0.05}, {"resolution_x": 30, "resolution_y": 50}),
    "aspect": ({"sensor_fit": "AUTO", "shift_y": 0.1}, {"pixel_aspect_x": 1.0, "pixel_aspect_y": 2.0}),
}

CHILD = """
from mathutils import Matrix
from feature4x.addon.io.import_scene import import_scene
from feature4x.addon.common.point_cloud import FLOAT4, read_attribute, write_attribute
from feature4x.addon.common.render_settings import save_multilayer

def fresh(name="scene"):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return load(name)

def load(name, **options):
    item = import_scene(Path(folder, name + ".f4x"), **options)
    scene = bpy.context.scene
    scene.render.engine = "FEATURE4X"
    scene.frame_set(FRAME)
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_object_index = True
    for name in ("alpha", "latent", "selection", "score"):
        setattr(layer.f4x_passes, name, True)
    return item

def exr(name):
    save_multilayer(bpy.context.scene, Path(folder, name + ".exr"))

def png(name, mode="RGB"):
    image = bpy.context.scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth = "PNG", mode, "8"
    bpy.context.scene.render.filepath = str(Path(folder, name + ".png"))
    bpy.ops.render.render(write_still=True)

def world(color):
    found = bpy.data.worlds.new("world")
    found.use_nodes = True
    found.node_tree.nodes["Background"].inputs["Color"].default_value = (*color, 1)
    bpy.context.scene.world = found

def cloud(kind):
    return next(o for o in bpy.data.objects if o.name.endswith(kind))

def plane(depth, size=9.0):
    mesh = bpy.data.meshes.new("plane")  # in the frame of the scene's root: faces the camera
    mesh.from_pydata([(-size, -size, depth), (size, -size, depth), (size, size, depth), (-size, size, depth)], [], [(0, 1, 2, 3)])
    item = bpy.data.objects.new("plane", mesh)
    bpy.context.scene.collection.objects.link(item)
    return item

def move_node():
    node = bpy.data.objects["random scene node 00001"]
    node.animation_data_clear()
    node.location = (0.3, -0.1, 2.0)
    bpy.context.view_layer.update()
"""

BODY = """
fresh(); exr("plain"); png("plain")
world(WORLD); png("world")
bpy.context.scene.render.film_transparent = True; png("film", "RGBA")

fresh()
scene = bpy.context.scene
scene.render.use_border = scene.render.use_crop_to_border = True
scene.render.border_min_x, scene.render.border_max_x = 0.2, 0.71
scene.render.border_min_y, scene.render.border_max_y = 0.3, 0.94
exr("border")

for name, (camera, render) in CAMERAS.items():
    fresh()
    data = bpy.context.scene.camera.data
    data.animation_data_clear()
    data.lens, data.shift_x, data.shift_y = 30.0, 0.0, 0.0
    for key, value in camera.items():
        setattr(data, key, value)
    for key, value in render.items():
        setattr(bpy.context.scene.render, key, value)
    exr("camera_" + name)

fresh()
bpy.context.scene.frame_set(FRAME, subframe=0.5); exr("half")
bpy.context.scene.frame_set(FRAME + 1); exr("next")

root = fresh()
bpy.context.view_layer.update()
camera = bpy.context.scene.camera
stands = camera.matrix_world.copy()
camera.parent = None
camera.animation_data_clear()
camera.matrix_world = stands
root.matrix_world = Matrix.Translation((0.3, 0.2, -0.1)) @ Matrix.Rotation(0.3, 4, "Z") @ root.matrix_world
bpy.context.view_layer.update()
exr("moved")
np.savez(folder / "moved.npz", root=np.array(root.matrix_world), camera=np.array(camera.matrix_world))

fresh(); move_node()
evaluated = cloud("dynamic").evaluated_get(bpy.context.evaluated_depsgraph_get()).data
np.savez(folder / "node.npz", means=read_attribute(evaluated, "position"), quats=read_attribute(evaluated, "rotation"))
exr("node")

fresh()
data = cloud("static").data
base = read_attribute(data, "radiance:base")
base[::3, 3] *= 0.25
base[1::3, :3] = (1.0, -1.0, 0.5)
write_attribute(data, "radiance:base", FLOAT4, base)
count = len(base)
write_attribute(data, "f4x_hidden", "BOOLEAN", np.arange(count) % 3 == 2)
write_attribute(data, ".selection", "BOOLEAN", np.arange(count) % 2 == 0)
write_attribute(data, "f4x_score", "FLOAT", np.linspace(0, 1, count))
exr("edited")

first = fresh(); second = load("scene", set_up_render=False)
second.location.x += 0.3
cloud("static").pass_index = 4
bpy.context.view_layer.update()
exr("two")
second.hide_render = True
for child in second.children:
    child.hide_render = True
exr("one_of_two")

root = fresh(); item = plane(2.0); item.parent = root; item.pass_index = 9; exr("wall")
item.is_holdout = True; exr("holdout")

fresh("labelled"); exr("labelled")

fresh()
bpy.context.scene.camera.data.type = "PANO"
try:
    png("panorama")
    print("NO ERROR")
except RuntimeError as error:
    print(error)
bpy.context.scene.camera.data.type = "ORTHO"
bpy.context.scene.camera.data.ortho_scale = 2.0
exr("ortho")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Everything that the child rendered, and the scenes."""
    folder = tmp_path_factory.mktemp("engine")
    write_scene(random_scene(degree=2), folder / "scene.f4x")
    labelled = labelled_scene()
    features = replace(labelled.features, pca=fit_pca(labelled.latents()))
    write_scene(replace(labelled, features=features), folder / "labelled.f4x")
    names = ("FRAME", "WORLD", "CAMERAS")
    constants = "".join(f"{name} = {globals()[name]!r}\n" for name in names)
    perform(folder, CHILD + constants + BODY)
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    return read_scene(folder / "scene.f4x")


def passes(folder, name):
    """Passes of an EXR by name: (H,W) or (H,W,C), colours in the order R, G, B, A."""
    found = {}
    for part in OpenEXR.File(str(folder / f"{name}.exr"), separate_channels=True).parts:
        for channel, content in part.channels.items():
            _, title, letter = channel.split(".")
            found.setdefault(title.replace("Object Index", "IndexOB"), {})[letter] = content.pixels
    order = {name: [c for c in "RGBAXZ" if c in letters] for name, letters in found.items()}
    return {name: np.squeeze(np.stack([found[name][c] for c in order[name]], -1)) for name in found}


def picture(folder, name):
    return cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3][: 3 + (name == "film")]]


def assert_equal_pictures(got, rgb):
    """Linear `got` against display `rgb`; float32 matrices move a Gaussian's edge, where alpha < 1/255 cuts, across a pixel."""
    error = np.abs(got[..., :3] - linear_from_srgb(rgb))
    print(f"mean {error.mean():.1e}, largest {error.max():.1e}")
    assert error.mean() < 1e-6 and np.quantile(error, 0.99) < 1e-5 and error.max() < 1e-2
    assert rgb.max() > 0.3


def test_untouched_it_is_the_cores_picture(folder, scene):
    expected = render(scene, scene.cameras[FRAME], FRAME, ("rgb", "depth", "alpha"))
    found = passes(folder, "plain")
    assert_equal_pictures(found["Combined"], expected["rgb"])
    assert (found["Combined"][..., 3] == 1).all()
    assert np.abs(found["Alpha"] - expected["alpha"]).mean() < 1e-6
    known = np.isfinite(expected["depth"])
    assert np.abs(found["Depth"] - expected["depth"])[known].mean() < 1e-5
    assert (found["Depth"][~known] == np.float32(1e10)).all() and 0 < known.mean() < 1
    assert set(np.unique(found["IndexOB"])) == {0}


def test_the_saved_png_is_the_cores_picture(folder, scene):
    for name, background in (("plain", (0, 0, 0)), ("world", None)):
        if background is None:
            background = [1.055 * c ** (1 / 2.4) - 0.055 for c in WORLD]
        images = render(scene, scene.cameras[FRAME], FRAME, ("rgb", "alpha"))
        expected = np.round(np.clip(over_background(images, background), 0, 1) * 255).astype(int)
        error = np.abs(picture(folder, name) - expected)
        assert error.max() <= 1 and (error > 0).mean() < 5e-3


def test_a_transparent_film_keeps_the_colour_under_the_alpha(folder, scene):
    out = render(scene, scene.cameras[FRAME], FRAME, ("rgb", "alpha"))
    found = picture(folder, "film").astype(int)
    assert np.abs(found[..., 3] - np.round(255 * out["alpha"])).max() <= 1
    solid = out["alpha"] > 0.5
    straight = np.clip(out["rgb"] / np.maximum(out["alpha"], 1e-6)[..., None], 0, 1)
    assert np.abs(found[..., :3] - 255 * straight)[solid].max() < 1.51


def test_a_render_region_is_cut_from_the_picture(folder):
    whole, part = passes(folder, "plain"), passes(folder, "border")
    rows, columns = (
        slice(HEIGHT - int(0.94 * HEIGHT), HEIGHT - int(0.3 * HEIGHT)),
        slice(int(0.2 * WIDTH), int(0.71 * WIDTH)),
    )
    for name in ("Combined", "Depth", "Alpha"):
        assert (part[name] == whole[name][rows, columns]).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_any_camera(folder, scene, name):
    """Sensor fit, shift, resolution and pixel aspect, by the formulas of Blender's manual."""
    data = {"shift_x": 0.0, "shift_y": 0.0, "sensor_width": 36.0, "sensor_height": 24.0} | CAMERAS[name][0]
    settings = {"resolution_x": WIDTH, "resolution_y": HEIGHT, "resolution_percentage": 100} | CAMERAS[name][1]
    width, height = (settings[f"resolution_{axis}"] * settings["resolution_percentage"] // 100 for axis in "xy")
    aspect = settings.get("pixel_aspect_y", 1.0) / settings.get("pixel_aspect_x", 1.0)
    lies = data["sensor_fit"] == "HORIZONTAL" or (data["sensor_fit"] == "AUTO" and width >= height * aspect)
    fitted = width if lies else height * aspect  # the side that the sensor's size belongs to, in pixel widths
    sensor = data["sensor_height"] if data["sensor_fit"] == "VERTICAL" else data["sensor_width"]
    focal = 30.0 / sensor * fitted
    matrix = np.array(
        [
            [focal, 0, width / 2 - data["shift_x"] * fitted],
            [0, focal / aspect, height / 2 + data["shift_y"] * fitted / aspect],
            [0, 0, 1],
        ]
    )
    camera = Camera(matrix, scene.cameras[FRAME].world_to_camera, width, height)
    assert_equal_pictures(passes(folder, f"camera_{name}")["Combined"], render(scene, camera, FRAME, ("rgb",))["rgb"])


def test_a_subframe_lies_between(folder):
    before, half, after = (passes(folder, name)["Combined"][..., :3] for name in ("plain", "half", "next"))
    assert min(np.abs(half - before).max(), np.abs(half - after).max()) > 1e-3
    assert np.abs(half - (before + after) / 2).mean() < np.abs(before - after).mean()


def test_the_whole_scene_moved(folder, scene):
    stored = np.load(folder / "moved.npz")
    view = np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(stored["camera"].astype(np.float64)) @ stored["root"]
    camera = replace(scene.cameras[FRAME], world_to_camera=view)
    assert not np.allclose(view, scene.cameras[FRAME].world_to_camera, atol=0.1)
    expected = render(scene, camera, FRAME, ("rgb",))
    assert_equal_pictures(passes(folder, "moved")["Combined"], expected["rgb"])


def test_a_node_moved(folder, scene):
    stored = np.load(folder / "node.npz")
    posed = scene.posed(FRAME)
    means, quats = posed.means.copy(), posed.quats.copy()
    means[posed.dynamic], quats[posed.dynamic] = stored["means"], stored["quats"]
    assert np.abs(means - posed.means).max() > 0.05

    class Moved:
        posed = staticmethod(lambda time: scene_posed)
        colors = staticmethod(scene.colors)
        fitted_focal = staticmethod(scene.fitted_focal)

    scene_posed = replace(posed, means=means, quats=quats)
    expected = render(Moved, scene.cameras[FRAME], FRAME, ("rgb",))
    assert_equal_pictures(passes(folder, "node")["Combined"], expected["rgb"])


def test_edited_attributes(folder, scene):
    static, count = scene.static, len(scene.static)
    opacity, sh = static.opacities.copy(), static.sh.copy()
    opacity[::3] *= 0.25
    sh[1::3, 0] = (1.0, -1.0, 0.5)
    opacity[2::3] = 0
    edited = replace(scene, static=replace(static, opacities=opacity, sh=sh))
    total = count + len(scene.dynamic)
    values = {"chosen": np.zeros((total, 1)), "score": np.zeros((total, 1))}
    values["chosen"][:count:2], values["score"][:count, 0] = 1, np.linspace(0, 1, count)
    expected = render(edited, scene.cameras[FRAME], FRAME, ("rgb", "alpha"), values=values)
    found = passes(folder, "edited")
    assert_equal_pictures(found["Combined"], expected["rgb"])
    assert np.abs(found["Selection"] - expected["chosen"][..., 0]).mean() < 1e-6
    covered = expected["alpha"] >= 0.11
    mean = expected["score"][..., 0][covered] / expected["alpha"][covered]
    assert np.abs(found["Score"][covered] - mean).mean() < 1e-5
    assert found["Selection"].max() > 0.5 and found["Score"].max() > 0.3


def test_two_scenes_in_one_picture(folder):
    both, one = passes(folder, "two"), passes(folder, "one_of_two")
    plain = passes(folder, "plain")
    assert (one["Combined"] == plain["Combined"]).all()
    added = (both["Alpha"] > plain["Alpha"] + 0.1).mean()
    assert added > 0.05 and (both["Alpha"] > plain["Alpha"] - 1e-3).all()
    assert set(np.unique(both["IndexOB"])) == {0, 4}


def test_a_mesh_hides_what_is_behind_it(folder, scene):
    wall, plain = passes(folder, "wall"), passes(folder, "plain")
    bare = plain["Alpha"] == 0
    assert bare.any() and np.allclose(wall["Depth"][bare], 2.0, atol=1e-5) and (wall["IndexOB"][bare] == 9).all()
    assert np.allclose(wall["Alpha"], 1)
    posed = scene.posed(FRAME)
    near = replace(posed, opacities=np.where(posed.means[:, 2] < 2.0, posed.opacities, 0))

    class Cut:
        posed = staticmethod(lambda time: near)
        colors = staticmethod(scene.colors)
        fitted_focal = staticmethod(scene.fitted_focal)

    expected = render(Cut, scene.cameras[FRAME], FRAME, ("rgb", "alpha"))
    hole = passes(folder, "holdout")
    assert np.abs(hole["Alpha"] - expected["alpha"]).mean() < 1e-6
    alpha = hole["Combined"][..., 3:]
    assert np.abs(alpha[..., 0] - expected["alpha"]).mean() < 1e-6
    seen = alpha[..., 0] > 1e-3  # the color under the alpha is what is linearised
    straight = np.where(seen[..., None], hole["Combined"][..., :3] / np.maximum(alpha, 1e-3), 0)
    assert_equal_pictures(straight, np.where(seen[..., None], expected["rgb"] / np.maximum(alpha, 1e-3), 0))


def test_the_latent_is_shown_in_the_colours_of_the_scene_file(folder):
    scene = read_scene(folder / "labelled.f4x")
    expected = render(scene, scene.cameras[FRAME], FRAME, ("latent", "alpha"))
    found = passes(folder, "labelled")["Latent"]
    covered = expected["alpha"] > 0.11
    shown = scene.features.pca.to_rgb(expected["latent"])[covered]
    assert np.abs(255 * np.clip(found[covered], 0, 1) - shown).max() < 1
    assert np.ptp(shown, axis=0).max() > 50


def test_a_panorama_is_refused_in_one_sentence(folder):
    log = (folder / "log.txt").read_text()
    assert "is not a perspective or orthographic camera; change its type" in log
    assert "Traceback" not in log and "NO ERROR" not in log
    assert not (folder / "panorama.png").exists()


def test_a_view_without_perspective(folder, scene):
    """It is that of a pinhole far away; ortho_scale is the width of the picture."""
    far, found = 700.0, passes(folder, "ortho")
    view = scene.cameras[FRAME].world_to_camera.copy()
    view[2, 3] += far
    focal = far * WIDTH / 2.0
    camera = Camera(np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]]), view, WIDTH, HEIGHT)
    imported = replace(scene, provenance={"import": {"file": "a.ply"}})  # no angle to widen splats by
    expected = render(imported, camera, FRAME, ("alpha", "depth"))
    assert np.abs(found["Alpha"] - expected["alpha"]).mean() < 1e-3 and expected["alpha"].max() > 0.5
    known = np.isfinite(expected["depth"]) & (found["Depth"] < 1e9)
    assert np.abs(found["Depth"] - (expected["depth"] - far))[known].mean() < 5e-3
