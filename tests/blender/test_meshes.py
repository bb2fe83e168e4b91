"""A mesh of a selection in Blender follows the nodes as the core says, does what its switches say, and shades Gaussians."""

from dataclasses import replace

import numpy as np
from random_scene import FRAMES
from shapes import carried_sphere, discs, plane, static_scene

from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import StaticSet, write_scene
from f4x_core.scene.formats.gltf_mesh import write_gltf_mesh
from f4x_core.scene.mesh import MeshConfig, carried, mesh_of
from f4x_core.scene.mesh.skin import linearly_carried
from f4x_core.scene.stage import Cloud, DrawSettings, draw

from .artist import perform

STRENGTH = 0.6

MAKE = """
from feature4x.addon.io.import_scene import import_scene
from feature4x.addon.scene.scene_object import SELECTED
from feature4x.addon.operators.meshes import is_made
bpy.ops.wm.read_factory_settings(use_empty=True)
import_scene(folder / "scene.f4x")
scene = bpy.context.scene
scene.render.engine = "FEATURE4X"

def picture(name):
    image = scene.render.image_settings
    image.file_format, image.color_mode, image.color_depth = "PNG", "RGB", "8"
    scene.render.filepath = str(folder / name)
    bpy.ops.render.render(write_still=True)
    return bpy.data.images.load(str(folder / (name + ".png")))

def pixels(name):
    image = picture(name)
    flat = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(image.size[1], image.size[0], -1)[::-1, :, :3].copy()

select(root())
noted["nothing"] = refused(ops.make_mesh)
shown = scene_object().shown.scene
scene_object().write(**{SELECTED: ("BOOLEAN", shown.moving)})
scene.frame_set(3)
arrays["without"] = pixels("without")
ops.make_mesh(resolution=24, faces=1500, current=True)
item = bpy.context.object
noted["made"] = is_made(item) and item.parent == root()
arrays["rest"] = np.array([v.co for v in item.data.vertices])
for frame in range(FRAMES):
    scene.frame_set(frame)
    seen = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    arrays[f"at/{frame}"] = np.array([v.co for v in seen.data.vertices])
scene.frame_set(3)
noted["hidden"] = not item.visible_camera and item.visible_shadow
arrays["with"] = pixels("with")
item.f4x_holds_out = True
noted["held"] = item.is_holdout and item.visible_camera
arrays["holdout"] = pixels("holdout")
item.f4x_holds_out = False
noted["free"] = not item.is_holdout and not item.visible_camera
ops.collider()
body = item.rigid_body
noted["body"] = [body.type, body.collision_shape, body.mesh_source, body.kinematic]
ops.collider()
noted["no body"] = item.rigid_body is None
# renamed nodes are in another order: the mesh goes on following its own
node = next(o for o in bpy.data.objects if o.name.endswith("node 00000"))
node.name = "zzz"
scene.frame_set(0)
scene.frame_set(4)
bpy.context.view_layer.update()
seen = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
arrays["renamed"] = np.array([v.co for v in seen.data.vertices])
bpy.data.objects.remove(node)
before = len(bpy.data.objects), len(bpy.data.meshes)
noted["missing"] = refused(ops.make_mesh, resolution=16)
noted["left"] = (len(bpy.data.objects), len(bpy.data.meshes)) == before
"""


def test_a_mesh_of_a_selection(tmp_path):
    scene = carried_sphere(strength=0.9)
    write_scene(scene, tmp_path / "scene.f4x")
    noted, arrays = perform(tmp_path, MAKE.replace("FRAMES", str(FRAMES)))
    assert "Nothing is selected" in noted["nothing"]
    assert noted["made"] and noted["hidden"] and noted["held"] and noted["free"] and noted["no body"]
    assert "1 node is missing" in noted["missing"] and noted["left"]
    assert noted["body"] == ["PASSIVE", "MESH", "FINAL", True]
    mesh = mesh_of(scene, scene.moving, 3.0, MeshConfig(24, 1500))
    np.testing.assert_allclose(arrays["rest"], mesh.vertices, atol=1e-6)
    moved = [carried(mesh.vertices.astype(float), mesh.skin, scene.scaffold, float(frame)) for frame in range(FRAMES)]
    assert np.abs(moved[0] - moved[4]).max() > 0.1
    for frame in range(FRAMES):
        np.testing.assert_allclose(arrays[f"at/{frame}"], moved[frame], atol=2e-5)
    np.testing.assert_allclose(arrays["renamed"], moved[4], atol=2e-5)
    np.testing.assert_array_equal(arrays["with"], arrays["without"])  # the engine draws the Gaussians
    np.testing.assert_array_equal(arrays["holdout"], arrays["without"])
    assert arrays["without"].std() > 0.05


READ = """
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 24
bpy.ops.import_scene.gltf(filepath=str(folder / "a.glb"))
item = next(o for o in bpy.data.objects if o.type == "MESH" and any(m.type == "ARMATURE" for m in o.modifiers))
for frame in range(FRAMES):
    scene.frame_set(frame)
    seen = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    arrays[str(frame)] = np.array([seen.matrix_world @ v.co for v in seen.data.vertices])
arrays["colors"] = np.array([c.color[:3] for c in item.data.color_attributes[0].data])
"""


def test_blender_reads_the_file(tmp_path):
    scene = carried_sphere(strength=0.9)
    mesh = mesh_of(scene, scene.moving, 3.0, MeshConfig(24, 600))
    write_gltf_mesh(scene, mesh, tmp_path / "a.glb")
    _, arrays = perform(tmp_path, READ.replace("FRAMES", str(FRAMES)))
    for frame in range(FRAMES):
        expected = linearly_carried(mesh.vertices.astype(float), mesh.skin, scene.scaffold, float(frame))
        # Blender normalises the weights that it reads and keeps them in single precision
        np.testing.assert_allclose(arrays[str(frame)], expected[:, [0, 2, 1]] * [1, 1, -1], atol=1e-3)
    assert np.ptp(arrays["colors"], axis=0).max() < 1e-3 and arrays["colors"][0, 0] > 2 * arrays["colors"][0, 1]


SHADE = (
    MAKE[: MAKE.index("select(root())")]
    + """
select(root())
bpy.ops.mesh.primitive_cube_add(size=0.4, location=(0, 1.2, 0))
cube = bpy.context.object
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
scene.collection.objects.link(sun)
sun.rotation_euler, sun.data.angle = (np.pi / 2, 0, 0), 0.0
arrays["off"] = pixels("off")
scene.f4x_shadows.use, scene.f4x_shadows.strength = True, STRENGTH
arrays["on"] = pixels("on")
cube.visible_shadow = False
arrays["no shadow"] = pixels("no_shadow")
cube.visible_shadow, cube.visible_camera = True, False
arrays["unseen"] = pixels("unseen")
bpy.data.objects.remove(sun)
arrays["no lamp"] = pixels("no_lamp")
cube.visible_camera = True
arrays["no lamp, seen"] = pixels("no_lamp_seen")
bpy.data.objects.remove(cube)
arrays["alone"] = pixels("alone")
scene.f4x_shadows.use = False
arrays["alone, off"] = pixels("alone_off")
# a mesh of these Gaussians casts no shadow on them
scene.f4x_shadows.use = True
scene_object().write(**{SELECTED: ("BOOLEAN", np.ones(len(scene_object().shown.scene.ids), bool))})
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
scene.collection.objects.link(sun)
sun.rotation_euler = (np.pi / 2, 0, 0)
select(root())
ops.make_mesh(resolution=24, faces=1500)
arrays["own mesh"] = pixels("own")
"""
)


def test_a_plane_below_a_cube_gets_a_dark_square(tmp_path):
    scene = static_scene(*plane(), 0.03)
    turn = np.arctan2(1.2, 2.0)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    pose[:3, 3] = -pose[:3, :3] @ [-1.2, 0, 0]
    intrinsics = np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]])
    cameras = CameraPath(np.tile(intrinsics, (2, 1, 1)), np.tile(pose, (2, 1, 1)), np.arange(2.0), 160, 120)
    scene = replace(scene, cameras=cameras, held_out=(), static=StaticSet(**discs(*plane(), 0.03)))
    write_scene(scene, tmp_path / "scene.f4x")
    _, arrays = perform(tmp_path, SHADE.replace("STRENGTH", str(STRENGTH)))
    for one, other in (("off", "no shadow"), ("off", "no lamp, seen"), ("alone", "alone, off"), ("alone", "own mesh")):
        np.testing.assert_array_equal(arrays[one], arrays[other], err_msg=f"{one} and {other}")
    np.testing.assert_array_equal(arrays["no lamp"], arrays["alone"])
    changed = np.abs(arrays["unseen"] - arrays["alone"]).max(-1)
    # what the square of the cube's outline on the plane comes to, point by point and pixel by pixel
    means = scene.static.means
    inside = (np.abs(means[:, :2]) < 0.2).all(1)
    expected = draw(
        [replace(Cloud.of_scene(scene, 0.0), light=np.where(inside, 1 - STRENGTH, 1.0))],
        [],
        scene.cameras[0],
        DrawSettings(),
    )["rgb"]
    np.testing.assert_allclose(arrays["unseen"], expected, atol=1.5 / 255)
    rows, columns = np.nonzero(changed > 0.05)
    corners, _ = scene.cameras[0].project(np.array([[x, y, 2.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)]))
    np.testing.assert_allclose([columns.min(), columns.max() + 1], [corners[:, 0].min(), corners[:, 0].max()], atol=3)
    np.testing.assert_allclose([rows.min(), rows.max() + 1], [corners[:, 1].min(), corners[:, 1].max()], atol=3)
    assert (arrays["unseen"] <= arrays["alone"]).all()
    seen = np.abs(arrays["on"] - arrays["off"]).max(-1) > 0
    assert seen.any() and not (seen & ~(changed > 0)).any()


LAMPS = {
    "SUN": {"energy": 2, "rotation_euler": (0.3, 0, 0), "angle": 0.3},
    "POINT": {"energy": 100, "shadow_soft_size": 0.2},
    "SPOT": {"energy": 100, "spot_size": 1.4, "spot_blend": 0.5, "shadow_soft_size": 0.1, "scale": (1, 1.5, 1)},
    "AREA": {"energy": 50, "shape": "RECTANGLE", "size": 0.3, "size_y": 0.6, "rotation_euler": (0.3, 0.1, 0.4)},
    "AREA ": {"energy": 50, "shape": "ELLIPSE", "size": 0.6, "size_y": 0.3, "scale": (1.5, 1, 1), "spread": 2.0},
}
CYCLES = """
from mathutils import Vector
from feature4x.addon.render import shadows
from feature4x.f4x_core.scene.shadows import light_left
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, SIDE = bpy.context.scene, 48
scene.render.engine, scene.cycles.samples, scene.cycles.max_bounces = "CYCLES", 256, 0
scene.cycles.use_denoising, scene.view_settings.view_transform = False, "Raw"
scene.render.resolution_x = scene.render.resolution_y = SIDE
scene.render.filter_size = 0.01
bpy.ops.mesh.primitive_plane_add(size=4)
material = bpy.data.materials.new("white")
material.use_nodes = True
tree = material.node_tree
shader, sink = tree.nodes.new("ShaderNodeBsdfDiffuse"), next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
shader.inputs[0].default_value = (1, 1, 1, 1)
tree.links.new(shader.outputs[0], sink.inputs[0])
bpy.context.object.data.materials.append(material)
plane = bpy.context.object
bpy.ops.mesh.primitive_cube_add(size=0.6, location=(0.2, 0.1, 0.7))
cube = bpy.context.object
cube.visible_camera = False
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2, (0, 0, 5)
scene.collection.objects.link(camera)
scene.camera = camera
image = scene.render.image_settings
image.file_format, image.color_depth = "OPEN_EXR", "32"
across = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
points = np.stack([*np.meshgrid(across, across), np.zeros((SIDE, SIDE))], -1).reshape(-1, 3)

def irradiance(name):
    scene.render.filepath = str(folder / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    flat = np.empty(len(picture.pixels), np.float32)
    picture.pixels.foreach_get(flat)
    return np.pi * flat.reshape(SIDE * SIDE, -1)[:, 0]

for name, settings in LAMPS.items():
    light = bpy.data.lights.new(name, name.strip())
    item = bpy.data.objects.new(name, light)
    item.location = 0.1, -0.1, 2
    for key, value in settings.items():
        setattr(item if hasattr(item, key) else light, key, value)
    scene.collection.objects.link(item)
    cube.visible_shadow = True
    arrays[f"{name} shaded"] = irradiance(f"{name} shaded")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    lamps, casters = shadows._lamps(depsgraph), [each for each, _ in shadows._casters(depsgraph)]
    arrays[f"{name} left"] = light_left(points, lamps, casters, 1.0)
    ways, given = lamps[0].rays(points, 10.0)
    arrays[f"{name} given"] = (given * np.maximum(ways[..., 2] / np.linalg.norm(ways, axis=2), 0)).sum(1)
    cube.visible_shadow = False
    arrays[f"{name} free"] = irradiance(f"{name} free")
    bpy.data.objects.remove(item)
noted["casters"] = len(casters)
"""


def test_lamps_shine_and_shade_as_in_cycles(tmp_path):
    """On a plane below a cube: what each lamp gives without the cube, and the fraction of it that is left behind the cube."""
    noted, arrays = perform(tmp_path, CYCLES.replace("LAMPS.items()", f"{LAMPS}.items()"))
    assert noted["casters"] == 2  # the plane, which lies behind every point, and the cube
    for name in LAMPS:
        free, given = arrays[f"{name} free"], arrays[f"{name} given"]
        off = np.abs(free - given) / free.max()
        assert np.median(off) < 0.01 and np.quantile(off, 0.98) < 0.03, (name, np.quantile(off, [0.5, 0.98]))
        bright = free > 0.05 * free.max()
        left, expected = arrays[f"{name} left"][bright], (arrays[f"{name} shaded"] / np.maximum(free, 1e-9))[bright]
        assert (expected < 0.02).sum() > 50, name
        off = np.abs(left - expected)
        assert off.mean() < 0.02 and np.quantile(off, 0.97) < 0.15, (name, off.mean(), np.quantile(off, 0.97))
