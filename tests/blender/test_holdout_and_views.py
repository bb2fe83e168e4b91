"""Holdouts and stereo of the engine, and what meshes look like in it."""

import numpy as np
import pytest

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
scene, layer = bpy.context.scene, bpy.context.view_layer
scene.render.engine = "FEATURE4X"
static, dynamic = (bpy.data.objects[f"tiny {kind}"] for kind in ("static", "dynamic"))

def picture(path):
    import OpenEXR
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    found = {name.rpartition(".")[2]: channel.pixels for name, channel in channels.items()}
    return np.stack([found[letter] for letter in "RGBA"], -1)

def render(name):
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    scene.render.filepath = str(folder / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    return None if scene.render.use_multiview else picture(folder / f"{name}.exr")

def both():
    scene.render.use_multiview = True
    scene.render.image_settings.views_format = "INDIVIDUAL"
    render("both")
    scene.render.use_multiview = False
    for side in ("left", "right"):
        arrays[f"both {side}"] = picture(folder / f"both_{side[0].upper()}.exr")

def plane(z):
    bpy.ops.mesh.primitive_plane_add(size=3)
    item = bpy.context.object
    item.parent, item.location = root_, (0, 0, z)
    return item

root_ = bpy.data.objects["tiny"]
"""


def test_gaussians_are_held_out_as_cycles_holds_out_meshes(tiny_folder):
    """By object, root, collection and view layer; where they are in front the picture has no alpha, with any film."""
    script = """
arrays["plain"] = render("plain")
dynamic.is_holdout = True
arrays["object"] = render("object")
scene.render.film_transparent = True
arrays["transparent"] = render("transparent")
from feature4x.addon.render import evaluated
reader = evaluated.Reader()
bpy.context.view_layer.update()
clouds, _ = reader.stage(bpy.context.evaluated_depsgraph_get())
noted["viewport"] = sorted(cloud.holdout for cloud in clouds)
dynamic.is_holdout, scene.render.film_transparent = False, False
root_.is_holdout = True
arrays["root"] = render("root")
root_.is_holdout = False
inside = layer.layer_collection.children["tiny"]
inside.holdout = True
arrays["collection"] = render("collection")
inside.holdout, inside.indirect_only = False, True
arrays["indirect"] = render("indirect")
inside.indirect_only = False
dynamic.hide_render = True
arrays["static"] = render("static")
"""
    noted, arrays = perform(tiny_folder, START + script)
    assert noted["viewport"] == [False, True]
    assert (arrays["plain"][..., 3] == 1).all()
    held = arrays["object"]
    assert held[..., 3].min() < 0.1 and held[..., 3].max() == 1
    assert (held[..., :3] <= arrays["plain"][..., :3].max() * held[..., 3:] + 1e-5).all()
    open_ = arrays["transparent"]
    assert (open_[..., 3] <= held[..., 3] + 1e-5).all() and np.abs(open_[..., 3] - held[..., 3]).max() > 0.3
    assert (open_[..., 3] <= 1).all() and open_[..., 3].sum() < arrays["static"][..., 3].sum()
    np.testing.assert_allclose(arrays["root"], arrays["collection"], atol=1e-6)
    assert arrays["root"][..., :3].max() < 1e-3 and arrays["root"][..., 3].min() < 0.1
    assert not arrays["indirect"][..., :3].any()


def test_held_out_meshes_leave_holes_for_another_picture(tiny_folder):
    """With the switch of the view layer, too: then the pass Holdout says where."""
    script = """
item = plane(3.5)
item.is_holdout = True
arrays["object"] = render("object")
item.is_holdout = False
arrays["shown"] = render("shown")
layer.f4x_hold_out_meshes = layer.f4x_passes.holdout = True
arrays["layer"] = render("layer")
settings = scene.render.image_settings
from feature4x.addon.common.render_settings import save_multilayer
save_multilayer(scene, folder / "passes.exr")
"""
    _, arrays = perform(tiny_folder, START + script)
    np.testing.assert_array_equal(arrays["object"], arrays["layer"])
    assert arrays["layer"][..., 3].min() == 0 and (arrays["shown"][..., 3] == 1).all()
    import OpenEXR

    parts = OpenEXR.File(str(tiny_folder / "passes.exr"), separate_channels=True).parts
    channels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    held = next(pixels for name, pixels in channels.items() if name.endswith("Holdout.X"))
    np.testing.assert_allclose(held, 1 - arrays["layer"][..., 3], atol=1e-6)


@pytest.mark.parametrize("way", ["OFFAXIS", "PARALLEL", "TOE"])
def test_each_eye_sees_what_a_camera_there_sees(tiny_folder, way):
    script = f"""
camera = scene.camera
data = camera.data
data.animation_data_clear()
data.shift_x, stereo, way = 0.05, data.stereo, {way!r}
stereo.interocular_distance, stereo.convergence_distance, stereo.convergence_mode, stereo.pivot = 0.3, 4.0, way, "CENTER"
scene.render.views_format = "STEREO_3D"
both()
from mathutils import Matrix
placed = camera.matrix_world.copy()
camera.animation_data_clear()
for name, side in (("left", -0.15), ("right", 0.15)):
    turn = Matrix.Rotation(np.arctan(side / 4.0) if way == "TOE" else 0.0, 4, "Y")
    camera.matrix_world = placed @ Matrix.Translation((side, 0, 0)) @ turn
    data.shift_x = 0.05 - (side * data.lens / data.sensor_width / 4.0 if way == "OFFAXIS" else 0.0)
    arrays[name] = render(name)
"""
    _, arrays = perform(tiny_folder, START + script)
    for name in ("left", "right"):
        np.testing.assert_allclose(arrays[f"both {name}"], arrays[name], atol=2e-3, err_msg=name)
    assert np.abs(arrays["left"] - arrays["right"]).mean() > 0.01


def test_views_of_several_cameras_are_those_of_each(tiny_folder):
    script = """
camera = scene.camera
camera.name = "eye_L"
other = camera.copy()
bpy.context.collection.objects.link(other)
other.name = "eye_R"
other.animation_data_clear()
other.location.x += 0.5
scene.render.views_format = "MULTIVIEW"
both()
arrays["left"] = render("left")
scene.camera = other
arrays["right"] = render("right")
"""
    _, arrays = perform(tiny_folder, START + script)
    for name in ("left", "right"):
        np.testing.assert_array_equal(arrays[f"both {name}"], arrays[name])
    assert np.abs(arrays["left"] - arrays["right"]).mean() > 0.01


MATERIALS = {
    "principled": ("input('Base Color', (0.2, 0.5, 0.1, 1))", [0.2, 0.5, 0.1], None),
    "emission": (
        "input('Base Color', (0, 0, 0, 1)); input('Emission Color', (1, 0, 0, 1)); input('Emission Strength', 0.25)",
        [0, 0, 0],
        [0.25, 0, 0],
    ),
    "an attribute": ("node('ShaderNodeAttribute').attribute_name = 'paint'; link()", [0.1, 0.2, 0.3], None),
    "mixed in": ("node('ShaderNodeRGB').outputs[0].default_value = (0.3, 0.2, 0.1, 1); link()", [0.3, 0.2, 0.1], None),
    "an image": ("node('ShaderNodeTexImage').image = checker; link()", [0, 0, 1], None),
    "the viewport's color": ("material.diffuse_color = (0.5, 0, 0, 1); bare()", [0.5, 0, 0], None),
}


@pytest.mark.parametrize("name", MATERIALS)
def test_meshes_have_the_plain_color_of_their_material(tiny_folder, name):
    code, color, glow = MATERIALS[name]
    script = f"""
item = plane(2.0)
material = bpy.data.materials.new("m")
material.use_nodes = True
tree = material.node_tree
shader = next(each for each in tree.nodes if each.type == "BSDF_PRINCIPLED")
item.data.materials.append(material)
checker = bpy.data.images.new("blue", 4, 4)
checker.pixels[:] = [0, 0, 1, 1] * 16
paint = item.data.attributes.new("paint", "FLOAT_COLOR", "POINT")
paint.data.foreach_set("color", [0.1, 0.2, 0.3, 1] * 4)
made = []

def input(name, value):
    shader.inputs[name].default_value = value

def node(kind):
    made.append(tree.nodes.new(kind))
    return made[-1]

def link():
    tree.links.new(made[-1].outputs[0], shader.inputs["Base Color"])

def bare():
    tree.links.remove(shader.outputs[0].links[0])

{code}
from feature4x.addon.render import evaluated
bpy.context.view_layer.update()
(surface,) = evaluated.stage(bpy.context.evaluated_depsgraph_get())[1]
arrays["colors"] = surface.corner_colors
noted["glow"] = None if surface.glow is None else surface.glow[0].tolist()
arrays["normals"] = surface.corner_normals
"""
    from f4x_core.scene.color import srgb_from_linear

    noted, arrays = perform(tiny_folder, START + script)
    np.testing.assert_allclose(
        arrays["colors"], np.tile(srgb_from_linear(np.array(color, float)), (2, 3, 1)), atol=2e-3
    )
    assert noted["glow"] == glow or np.allclose(noted["glow"], glow)
    normals = arrays["normals"].reshape(-1, 3)
    assert np.allclose(
        normals / np.linalg.norm(normals, axis=1, keepdims=True), normals[0] / np.linalg.norm(normals[0])
    )
