"""Passes in Blender: of meshes those of Cycles, of Gaussians the core's; the compositor reads what `f4x render` writes."""

import json

import numpy as np
import OpenEXR
import pytest
from labelled_scene import labelled_scene, square_mask

from f4x_core.cli.main import main
from f4x_core.geometry.trajectory import View
from f4x_core.query.matte import mattes
from f4x_core.scene import write_scene
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.cryptomatte import identify
from f4x_core.scene.exposure import Exposure, Lens, Take, shoot
from f4x_core.scene.stage import Cloud, DrawSettings
from f4x_core.scene.view import render

from .artist import perform

T = 2

CHILD = """
from feature4x.addon.io.import_scene import import_scene
from feature4x.addon.common.render_settings import save_multilayer

def switch(layer):
    layer.use_pass_z = layer.use_pass_vector = layer.use_pass_normal = layer.use_pass_position = layer.use_pass_mist = True
    layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_asset = True

def exr(name):
    save_multilayer(bpy.context.scene, Path(folder, name + ".exr"))

def load(name):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_scene(Path(folder, name + ".f4x"))
    bpy.context.scene.render.engine = "FEATURE4X"
    bpy.context.scene.frame_set(T)
    return item

# a quad that moves and turns, seen by a camera that moves: both engines
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.cycles.samples, scene.cycles.pixel_filter_type, scene.cycles.filter_width = 1, "BOX", 0.01
scene.render.resolution_x, scene.render.resolution_y = 64, 48
mesh = bpy.data.meshes.new("quad")
mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
quad = bpy.data.objects.new("quad", mesh)
props = bpy.data.collections.new("props")
scene.collection.children.link(props)
props.objects.link(quad)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera = camera
for frame in (1, 2, 3):
    quad.location, quad.rotation_euler = (0.4 * frame - 1, 0.2 * frame**2 - 1, 0), (0.3, 0.1 * frame, 0)
    camera.location = (0.05 * frame**2, 0, 6 - 0.2 * frame)
    for item, paths in ((quad, ("location", "rotation_euler")), (camera, ("location",))):
        for path in paths:
            item.keyframe_insert(path, frame=frame)
scene.world = bpy.data.worlds.new("world")
scene.world.mist_settings.start, scene.world.mist_settings.depth = 2, 10
switch(bpy.context.view_layer)
scene.frame_set(2)
for engine in ("CYCLES", "FEATURE4X"):
    scene.render.engine = engine
    exr(engine)

load("named")
layer = bpy.context.view_layer
switch(layer)
layer.f4x_passes.alpha = layer.f4x_passes.unseen = True
for item in bpy.data.objects:
    if item.type == "POINTCLOUD":
        item.users_collection[0].name = "shot"
bpy.context.scene.frame_set(T)
exr("named")

load("named")  # its motion is linear, as Blender's keys are
scene = bpy.context.scene
scene.frame_set(T)
scene.f4x_samples = 8
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.8
bpy.context.view_layer.use_pass_z = True
exr("blur")
print("FRAME", scene.frame_current, flush=True)
scene.render.use_motion_blur = False
exr("still")
data = scene.camera.data
data.dof.use_dof, data.dof.focus_distance, data.dof.aperture_fstop = True, 1.5, data.lens * 1e-3 / (2 * 0.05)
exr("lens")

# Blender's compositor and the core's own file
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
image = bpy.data.images.load(str(folder / "core/00002.exr"))
scene.render.resolution_x, scene.render.resolution_y = 64, 40
scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(scene.camera)
old = "node_tree" in scene.bl_rna.properties  # Blender 4
if old:
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
else:
    tree = scene.compositing_node_group = bpy.data.node_groups.new("merge", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
node = tree.nodes.new("CompositorNodeImage")
node.image = image
print("SOCKETS", sorted(socket.name for socket in node.outputs if socket.enabled), flush=True)
matte = tree.nodes.new("CompositorNodeCryptomatteV2")
matte.source, matte.image = "IMAGE", image
matte.layer_name, matte.matte_id = "ViewLayer.CryptoObject", "square"
out = tree.nodes.new("CompositorNodeComposite" if old else "NodeGroupOutput")
tree.links.new(node.outputs["Combined"], matte.inputs["Image"])
tree.links.new(matte.outputs["Matte"], out.inputs["Image"])
exr("matte")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("passes")
    scene = labelled_scene()
    write_scene(scene, folder / "named.f4x")
    ids = scene.ids[scene.moving]
    (folder / "ops.json").write_text(
        json.dumps([{"op": "name", "select": {"by": "ids", "ids": ids.tolist()}, "name": "hero"}])
    )
    assert main(["edit", str(folder / "named.f4x"), "--ops", str(folder / "ops.json")]) == 0
    channels = "rgb,alpha,depth,vector,normal,position,mist,unseen,cryptomatte,mask:square"
    arguments = ["render", str(folder / "named.f4x"), "-o", str(folder / "core"), "--exr", "--frames", f"{T}:{T + 1}"]
    assert main([*arguments, "--channels", channels]) == 0
    perform(folder, f"T = {T}\n" + CHILD)
    return folder


def passes(folder, name):
    """(pass -> (H,W,C), attributes) of a multi-layer EXR."""
    parts = OpenEXR.File(str(folder / f"{name}.exr"), separate_channels=True).parts  # one for each pass in Blender 5
    found = {}
    for part in parts:
        for channel, content in part.channels.items():
            _, title, letter = channel.split(".")
            found.setdefault(title, {})[letter] = content.pixels
    order = "rgbaRGBAXYZWV"
    stacked = {n: np.squeeze(np.stack([c[x] for x in order if x in c], -1)) for n, c in found.items()}
    header = {key: value for part in parts for key, value in part.header.items()}
    return stacked, {key: value for key, value in header.items() if key.startswith("cryptomatte")}


def test_a_mesh_has_the_passes_of_cycles(folder):
    (ours, our_header), (theirs, header) = passes(folder, "FEATURE4X"), passes(folder, "CYCLES")
    both = (ours["Depth"] < 1e9) & (theirs["Depth"] < 1e9)
    for axis in (0, 1):  # Cycles looks through a pixel's edge somewhere else
        both &= np.roll(both, 1, axis) & np.roll(both, -1, axis)
    assert both.sum() > 200
    for name, tolerance in (("Depth", 5e-3), ("Position", 2e-2), ("Normal", 1e-4), ("Mist", 2e-3), ("Vector", 2e-2)):
        error = np.abs(ours[name][both] - theirs[name][both])
        print(f"{name}: mean {error.mean():.1e}, largest {error.max():.1e} of {np.abs(theirs[name][both]).max():.2f}")
        assert error.max() < tolerance, name
    assert np.abs(theirs["Vector"][both]).max() > 2
    outside = ~(ours["Depth"] < 1e9)
    assert (ours["Mist"][outside] == 1).all() and (ours["Vector"][outside] == 0).all()
    np.testing.assert_array_equal(ours["CryptoObject00"][both], theirs["CryptoObject00"][both])
    for key, value in header.items():
        if key.endswith(("name", "hash", "conversion")):
            assert our_header[key] == value
    assert f'"quad":"{identify("quad"):08x}"' in our_header["cryptomatte/542cafa/manifest"]
    assert f'"props":"{identify("props"):08x}"' in our_header["cryptomatte/aa21542/manifest"]


def test_gaussians_have_the_passes_of_f4x_render(folder):
    """Names, numbers and mattes; world axes differ: Blender's z is up."""
    (blender, _), (core, _) = passes(folder, "named"), passes(folder, "core/00002")
    np.testing.assert_allclose(blender["Vector"], core["Vector"], atol=1e-3)
    for name in ("Alpha", "Unseen"):
        np.testing.assert_allclose(blender[name], core[name], atol=1e-3)
    turned = core["Position"][..., [0, 2, 1]] * [1, 1, -1]
    np.testing.assert_allclose(blender["Position"], turned, atol=1e-4)
    np.testing.assert_allclose(blender["Normal"], core["Normal"][..., [0, 2, 1]] * [1, 1, -1], atol=1e-4)


def test_named_selections_and_collections_are_mattes(folder):
    found, header = passes(folder, "named")
    ids = found["CryptoObject00"][..., 0].copy().view(np.uint32)
    assert ((ids == identify("hero")) == square_mask(T)).mean() > 0.97
    assert f'"hero":"{identify("hero"):08x}"' in header["cryptomatte/542cafa/manifest"]
    collection = found["CryptoAsset00"]
    np.testing.assert_allclose(collection[..., 1], found["Alpha"], atol=1e-5)
    assert set(np.unique(collection[..., 0].copy().view(np.uint32))) == {identify("shot")}


def test_mattes_of_selections_follow_the_edges_of_the_picture(folder):
    scene, (found, _) = labelled_scene(), passes(folder, "named")
    expected = mattes(scene, scene.moving[:, None], View(scene.cameras[T], T))[..., 0]
    covered = render(scene, scene.cameras[T], T, (), values={"hero": scene.moving[:, None].astype(np.float32)})["hero"]
    assert np.abs(covered[..., 0] - expected).max() > 0.1

    pairs = np.concatenate([found[f"CryptoObject0{number}"] for number in range(3)], -1)
    ids, parts = pairs[..., ::2].copy().view(np.uint32), pairs[..., 1::2]
    hero = (parts * (ids == identify("hero"))).sum(-1)
    np.testing.assert_allclose(hero, np.minimum(expected, found["Alpha"]), atol=2e-3)  # no more than the scene covers
    np.testing.assert_allclose(parts.sum(-1), found["Alpha"], atol=1e-4)


def test_motion_blur_and_depth_of_field_are_the_cores(folder):
    scene = labelled_scene()

    def take_at(offset):
        return Take([Cloud.of_scene(scene, T + offset)], [], scene.cameras.at(T + offset))

    for name, exposure in (
        ("blur", Exposure(8, -0.4, 0.4)),
        ("lens", Exposure(8, lens=Lens(0.05, 1.5))),
    ):
        found, _ = passes(folder, name)
        expected = shoot(take_at, exposure, DrawSettings())["combined"]
        sharp = linear_from_srgb(render(scene, scene.cameras[T], T, ("rgb",))["rgb"])
        error = np.abs(found["Combined"][..., :3] - expected[..., :3])
        blur = np.abs(sharp - expected[..., :3])
        print(f"{name}: mean error {error.mean():.1e} of a blur of {blur.mean():.1e}")
        assert error.mean() < 0.05 * blur.mean() and blur.mean() > 1e-3
    still, _ = passes(folder, "still")
    np.testing.assert_allclose(passes(folder, "blur")[0]["Depth"], still["Depth"], atol=1e-4)
    assert f"FRAME {T}\n" in (folder / "log.txt").read_text()


def test_the_compositor_reads_what_f4x_render_wrote(folder):
    log = (folder / "log.txt").read_text()
    sockets = next(line for line in log.splitlines() if line.startswith("SOCKETS"))
    for name in ("Combined", "Depth", "Vector", "Normal", "Position", "Mist", "CryptoObject00"):
        assert f"'{name}'" in sockets
    channels = OpenEXR.File(str(folder / "matte.exr"), separate_channels=True).parts[0].channels
    assert ((channels["Composite.Combined.R"].pixels > 0.5) == square_mask(T)).mean() > 0.97
