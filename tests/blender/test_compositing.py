"""*Composite*: Cycles draws the meshes, the engine the Gaussians, and the compositor merges them by depth."""

import numpy as np

from .artist import perform

START = """
bpy.ops.wm.read_factory_settings(use_empty=True)
ops.import_scene(filepath=str(folder / "scene.f4x"))
scene, layer = bpy.context.scene, bpy.context.view_layer
scene.render.engine = "FEATURE4X"
from feature4x.addon.render import compositing
from feature4x.addon.common.render_settings import save_png
from mathutils import Matrix
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5)
ball = bpy.context.object
ball.parent, ball.location = bpy.data.objects["tiny"], (0.1, 0, 0.2)
material = bpy.data.materials.new("glow")
material.use_nodes = True
shader = next(each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
for name, value in (("Base Color", (0, 0, 0, 1)), ("Emission Color", (0.1, 0.6, 0.2, 1)), ("Emission Strength", 1)):
    shader.inputs[name].default_value = value
for name in ("Specular IOR Level", "Roughness"):
    shader.inputs[name].default_value = 0 if name[0] == "S" else 1
ball.data.materials.append(material)

def nodes():
    old = "node_tree" in scene.bl_rna.properties
    tree = scene.node_tree if old else scene.compositing_node_group
    return [] if tree is None else [node.name for node in tree.nodes]

def picture():
    from feature4x.addon.common.render_settings import save_multilayer
    import OpenEXR
    save_multilayer(scene, folder / "all.exr")
    parts = OpenEXR.File(str(folder / "all.exr"), separate_channels=True).parts
    channels = {name: one.pixels for part in parts for name, one in part.channels.items()}
    def stacked(prefix):
        return np.stack([channels[f"{prefix}.{letter}"] for letter in "RGBA"], -1)
    held = next((pixels for name, pixels in channels.items() if name.endswith("Holdout.X")), None)
    return channels, stacked, held
"""


def test_the_picture_is_that_of_both_engines_by_depth(tiny_folder):
    """A ball that glows in one color: where it is seen alone it has that color, elsewhere all is as it was."""
    script = """
scene.render.film_transparent = False
noted["done"] = list(ops.composite(engine="CYCLES"))
other = scene[compositing.MESHES]
other.cycles.samples, other.cycles.use_denoising = 64, False
other.view_layers[0].use_pass_z = True
channels, stacked, held = picture()
arrays["held"] = held
name = next(name for name in channels if name.startswith("Composite"))
arrays["whole"] = stacked(name.rpartition(".")[0])
arrays["gaussians"] = stacked("ViewLayer.Combined")
ball.hide_render = True
arrays["without"] = picture()[1]("ViewLayer.Combined")
noted["engines"] = [scene.render.engine, other.render.engine]
noted["seen"] = sorted(item.type for item in other.view_layers[0].objects)
"""
    noted, arrays = perform(tiny_folder, START + script)
    assert noted["done"] == ["FINISHED"] and noted["engines"] == ["FEATURE4X", "CYCLES"]
    assert "POINTCLOUD" not in noted["seen"] and "MESH" in noted["seen"]
    held, whole = arrays["held"], arrays["whole"]
    assert (held == 0).any() and (held > 0.9).any() and ((held > 0.2) & (held < 0.8)).any()
    np.testing.assert_allclose(whole[held == 0], arrays["without"][held == 0], atol=1e-5)
    expected = arrays["gaussians"][..., :3] + held[..., None] * [0.1, 0.6, 0.2]
    np.testing.assert_allclose(whole[..., :3], expected, atol=0.02)
    np.testing.assert_allclose(whole[..., 3], 1, atol=1e-3)


def test_it_is_one_step_of_undo_and_may_be_done_again(tiny_folder):
    script = """
push("before")
ops.composite("EXEC_DEFAULT", True, engine="CYCLES")
once = nodes()
ops.composite("EXEC_DEFAULT", True, engine="EEVEE")
noted["twice"] = nodes() == once, len(bpy.data.scenes), bpy.context.scene[compositing.MESHES].render.engine
scene.render.resolution_x = 123
compositing.synchronize(scene)
noted["size"] = scene[compositing.MESHES].render.resolution_x
extra = bpy.data.objects.new("later", ball.data)
scene.collection.objects.link(extra)
compositing.synchronize(scene)
noted["later"] = "later" in scene[compositing.MESHES].collection.objects
bpy.ops.ed.undo()
bpy.ops.ed.undo()
scene = bpy.context.scene
noted["undone"] = [len(bpy.data.scenes), compositing.MESHES in scene, bpy.context.view_layer.f4x_hold_out_meshes]
noted["splats"] = [len(each.objects) for each in bpy.data.collections if compositing.SPLATS in each]
"""
    noted, _ = perform(tiny_folder, START + script)
    same, scenes, engine = noted["twice"]
    assert same and scenes == 2 and engine.startswith("BLENDER_EEVEE")
    assert noted["size"] == 123 and noted["later"]
    assert noted["undone"] == [1, False, False] and not noted["splats"]


def test_edits_go_on_in_the_collection_of_gaussians(tiny_folder):
    """The separate cloud of moved Gaussians is left out of the scene for meshes, too."""
    script = """
ops.composite(engine="CYCLES")
select(bpy.data.objects["tiny"])
ops.change_selection(how="ALL")
ops.transform(move=(0.1, 0, 0))
compositing.synchronize(scene)
noted["clouds"] = sorted(item.name for item in scene.objects if item.type == "POINTCLOUD")
layer = scene[compositing.MESHES].view_layers[0]
layer.update()
noted["seen"] = [item.name for item in layer.objects if item.type == "POINTCLOUD"]
"""
    noted, _ = perform(tiny_folder, START + script)
    assert len(noted["clouds"]) == 3 and noted["seen"] == []
