"""Meshes, lamps and copies among the splats of a scene in Blender 5.3, and pictures of it by Cycles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import door
import numpy as np

door.load_extension()
CHECKER, LIGHT, DARK = 8, 0.6, 0.3
"""Pixels of a square of the checkerboard behind transparent pictures; its linear grays."""
ASIDE = 0.25
"""Distance of a ball to the side of what moves, in widths of the view."""
MODEL, REACH = 0.25, 0.1
"""Size of a model of the scene; how far around a place its floor is looked for, world units."""


FAR = 1e4
"""Length of rays to a sun."""


def check_splats() -> None:
    """Raise F4xError where this Blender has no splats of its own."""
    from feature4x.addon.common.gaussian_attributes import draws_splats
    from feature4x.f4x_core.errors import F4xError

    if not draws_splats():
        import bpy

        raise F4xError(f"Blender {bpy.app.version_string} has no splats of its own; use 5.3 or later.")


def clouds_below(root: Any) -> list[Any]:
    """Return the point clouds of a scene that hold Gaussians."""
    return [item for item in root.children_recursive if item.type == "POINTCLOUD" and len(item.data.points)]


def places(cloud: Any) -> np.ndarray:
    """Return (N,3): where a cloud's points are now, in the world."""
    import bpy
    from feature4x.addon.common.point_cloud import read_attribute

    data = cloud.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    matrix = np.array(cloud.matrix_world)
    position = read_attribute(data, "position")
    assert position is not None  # every point cloud has it
    return position @ matrix[:3, :3].T + matrix[:3, 3]


@dataclass(frozen=True)
class Stage:
    """A scene in an otherwise empty file, and where things fit into it."""

    root: Any
    middle: np.ndarray
    """(3,) of what moves, else of all; world units."""
    size: float
    """Width of the camera's view at that distance."""
    distance: float
    """Of `middle` from the camera, along its axis."""

    @classmethod
    def of(cls, path: Path, frame: int) -> Stage:
        """Import a scene into an empty file and show a frame."""
        import bpy

        if "f4x" in bpy.types.Object.bl_rna.properties:
            bpy.ops.wm.read_factory_settings(use_empty=True)
        else:
            door.start_blender()
        root = door.import_scene(path)
        bpy.context.scene.frame_set(frame)
        camera = bpy.context.scene.camera
        clouds = clouds_below(root)
        moving = [cloud for cloud in clouds if cloud.modifiers.get("Feature4X motion")] or clouds
        middle = np.median(np.concatenate([places(cloud) for cloud in moving]), axis=0)
        view = np.linalg.inv(np.array(camera.matrix_world))
        distance = -float((view[:3, :3] @ middle + view[:3, 3])[2])
        return cls(root, middle, distance * camera.data.sensor_width / camera.data.lens, distance)

    @property
    def clouds(self) -> list[Any]:
        """Return all point clouds."""
        return clouds_below(self.root)

    @property
    def moving(self) -> list[Any]:
        """Return the point clouds that nodes move."""
        return [cloud for cloud in self.clouds if cloud.modifiers.get("Feature4X motion")]

    @property
    def camera(self) -> Any:
        """Return the clip's camera."""
        import bpy

        return bpy.context.scene.camera

    def floor_below(self, x: float, y: float, reach: float) -> float:
        """Return the height of what lies below a place: few points within `reach` are lower."""
        still = np.concatenate([places(cloud) for cloud in self.clouds if cloud not in self.moving])
        near = np.hypot(still[:, 0] - x, still[:, 1] - y) < reach
        return float(np.percentile(still[near, 2], 30)) if near.any() else float(self.middle[2]) - reach

    def ball(self, name: str, side: float, material: Any) -> Any:
        """Put a ball on the floor, to the left (-1) or to the right (1) of what moves."""
        import bpy

        radius = 0.1 * self.size
        x, y = self.middle[0] + side * ASIDE * self.size, self.middle[1] - 0.05 * self.size
        z = self.floor_below(x, y, radius) + 0.95 * radius
        bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=radius, location=(x, y, z))
        ball = bpy.context.object
        ball.name = name
        ball.data.shade_smooth()
        ball.data.materials.append(material)
        return ball

    def slab(self) -> Any:
        """Put a flat white box on the floor below what moves."""
        import bpy

        x, y, _ = self.middle
        z = self.floor_below(x, y, 0.2 * self.size)
        bpy.ops.mesh.primitive_cube_add(
            size=1, location=(x, y, z), scale=(0.5 * self.size, 0.3 * self.size, 0.03 * self.size)
        )
        slab = bpy.context.object
        slab.data.materials.append(matte((0.8, 0.8, 0.8)))
        return slab

    def sun(self, direction: tuple[float, float, float]) -> Any:
        """Add a sun that shines along `direction`: a surface that faces it sends back its own color."""
        import bpy
        from mathutils import Vector

        data = bpy.data.lights.new("sun", "SUN")
        data.energy, data.angle = np.pi, 0.05
        lamp = bpy.data.objects.new("sun", data)
        bpy.context.scene.collection.objects.link(lamp)
        lamp.rotation_mode = "QUATERNION"
        lamp.rotation_quaternion = Vector(direction).to_track_quat("-Z", "Y")
        bpy.context.view_layer.update()
        return lamp

    def model(self, side: float) -> Any:
        """Return (4,4) that makes a smaller model of the scene, on the floor to the left (-1) or right (1) of what moves."""
        from mathutils import Matrix, Vector

        x, y, _ = self.middle
        there = x + side * 0.28 * self.size, y - 0.1 * self.size
        feet, place = Vector((x, y, self.floor_below(x, y, REACH))), Vector((*there, self.floor_below(*there, REACH)))
        return Matrix.Translation(place) @ Matrix.Scale(MODEL, 4) @ Matrix.Translation(-feet)

    def instance(self, matrix: Any) -> Any:
        """Add a collection instance of the scene."""
        import bpy

        empty = bpy.data.objects.new("instance", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", self.root.users_collection[0]
        bpy.context.scene.collection.objects.link(empty)
        empty.matrix_world = matrix
        return empty

    def array(self, count: int, step: float) -> Any:
        """Add an object whose geometry nodes put instances of what moves in a row along X, the first one beside it."""
        import bpy

        tree = bpy.data.node_groups.new("array", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        info = tree.nodes.new("GeometryNodeObjectInfo")
        info.transform_space = "RELATIVE"
        info.inputs["Object"].default_value = (self.moving or self.clouds)[0]
        info.inputs["As Instance"].default_value = True
        line, put = tree.nodes.new("GeometryNodeMeshLine"), tree.nodes.new("GeometryNodeInstanceOnPoints")
        line.inputs["Count"].default_value = count
        line.inputs["Start Location"].default_value = (-step * (count // 2), 0, 0)
        line.inputs["Offset"].default_value = (step, 0, 0)
        out = tree.nodes.new("NodeGroupOutput")
        tree.links.new(line.outputs["Mesh"], put.inputs["Points"])
        tree.links.new(info.outputs["Geometry"], put.inputs["Instance"])
        tree.links.new(put.outputs["Instances"], out.inputs[0])
        item = bpy.data.objects.new("array", bpy.data.meshes.new("array"))
        item.modifiers.new("array", "NODES").node_group = tree
        bpy.context.scene.collection.objects.link(item)
        return item

    def second(self, path: Path, matrix: Any, later: float) -> Any:
        """Import a scene a second time, moved by `matrix`, to start `later` frames later; the first one's camera stays."""
        import bpy

        camera, frame = bpy.context.scene.camera, bpy.context.scene.frame_current
        other = door.import_scene(path)
        bpy.context.scene.camera = camera
        other.f4x.start_frame += later
        other.matrix_world = matrix @ other.matrix_world
        bpy.context.scene.frame_set(frame)
        return other

    def world(self, color: tuple[float, float, float], strength: float) -> None:
        """Light the scene from all sides."""
        import bpy

        world = bpy.data.worlds.new("world")
        world.use_nodes = True
        background = world.node_tree.nodes["Background"].inputs
        background["Color"].default_value, background["Strength"].default_value = (*color, 1), strength
        bpy.context.scene.world = world


def principled(name: str, **inputs: Any) -> Any:
    """Return a material of Blender's Principled BSDF."""
    import bpy

    material = bpy.data.materials.new(name)
    material.use_nodes = True
    sockets = material.node_tree.nodes["Principled BSDF"].inputs
    for key, value in inputs.items():
        sockets[key.replace("_", " ")].default_value = value
    return material


def metal() -> Any:
    """Return polished metal."""
    return principled("metal", Base_Color=(0.9, 0.9, 0.9, 1), Metallic=1.0, Roughness=0.03)


def glass() -> Any:
    """Return clear glass."""
    return principled("glass", Base_Color=(1, 1, 1, 1), Transmission_Weight=1.0, Roughness=0.0, IOR=1.45)


def matte(color: tuple[float, float, float]) -> Any:
    """Return a dull surface of a color."""
    return principled("matte", Base_Color=(*color, 1), Roughness=0.9)


def take_shadows(cloud: Any, sun: Any, share: float = 0.75) -> None:
    """Give a cloud a material in its own colors, darker by `share` where a mesh stands between a splat and a sun.

    The node *Raycast* looks from the place of the splat to the sun, into a slightly different direction for each sample, so that
    the sun's *Angle* makes soft edges. Splats are no obstacles to it (*Ray Visibility > Raycast*). The sun may be moved and keyed.
    """
    import bpy

    cloud.visible_raycast = False
    tree = _emptied(cloud, "takes shadows")
    add, link = tree.nodes.new, tree.links.new
    color, place, noise = add("ShaderNodeAttribute"), add("ShaderNodeNewGeometry"), add("ShaderNodeTexWhiteNoise")
    color.attribute_name = "rgb"
    centered, jitter = add("ShaderNodeVectorMath"), add("ShaderNodeVectorMath")
    centered.operation, centered.inputs[1].default_value = "SUBTRACT", (0.5, 0.5, 0.5)
    jitter.operation = "MULTIPLY_ADD"
    jitter.inputs[1].default_value = (sun.data.angle,) * 3
    to_sun, ray = add("ShaderNodeCombineXYZ"), add("ShaderNodeRaycast")
    ray.inputs["Length"].default_value = FAR
    for row, socket in enumerate(to_sun.inputs):
        driver = socket.driver_add("default_value").driver
        variable = driver.variables.new()
        variable.name = "z"
        variable.targets[0].id, variable.targets[0].data_path = (
            sun,
            f"matrix_world[2][{row}]",
        )  # paths count columns first
        driver.expression = "z"
    lit, dimmed = add("ShaderNodeMath"), add("ShaderNodeEmission")
    lit.operation = "MULTIPLY_ADD"
    lit.inputs[1].default_value, lit.inputs[2].default_value = -share, 1.0
    for source, sink in (
        (place.outputs["Position"], noise.inputs["Vector"]),
        (noise.outputs["Color"], centered.inputs[0]),
        (centered.outputs[0], jitter.inputs[0]),
        (to_sun.outputs[0], jitter.inputs[2]),
        (place.outputs["Position"], ray.inputs["Position"]),
        (jitter.outputs[0], ray.inputs["Direction"]),
        (ray.outputs["Is Hit"], lit.inputs[0]),
        (lit.outputs[0], dimmed.inputs["Strength"]),
        (color.outputs["Color"], dimmed.inputs["Color"]),
        (dimmed.outputs[0], add("ShaderNodeOutputMaterial").inputs["Surface"]),
    ):
        link(source, sink)
    bpy.context.view_layer.update()


def catch_shadows(cloud: Any) -> None:
    """Make a cloud a shadow catcher, which takes a material that lamps light, from both sides.

    Splats do not shade each other then. Without `max_bounces` = 0 a picture of a whole scene takes many minutes.
    """
    cloud.is_shadow_catcher, cloud.visible_shadow, cloud.visible_diffuse = True, False, False
    tree = _emptied(cloud, "catches shadows")
    add = tree.nodes.new
    both, out = add("ShaderNodeAddShader"), add("ShaderNodeOutputMaterial")
    for kind, socket in zip(("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent"), both.inputs, strict=True):
        tree.links.new(add(kind).outputs[0], socket)
    tree.links.new(both.outputs[0], out.inputs["Surface"])


def _emptied(cloud: Any, title: str) -> Any:
    """Give a cloud one new material in place of its own, and return its emptied node tree."""
    import bpy

    material = bpy.data.materials.new(f"{cloud.name} {title}")
    material.use_nodes = True
    material.node_tree.nodes.clear()
    cloud.data.materials.clear()
    cloud.data.materials.append(material)
    return material.node_tree


def render(samples: int, denoised: bool, transparent: bool = False) -> np.ndarray:
    """Return (H,W,4) linear colors, premultiplied, and alpha of the current scene as Cycles draws it."""
    import bpy
    from feature4x.addon.common.render_settings import save_multilayer

    scene = bpy.context.scene
    scene.render.engine, scene.render.film_transparent = "CYCLES", transparent
    scene.cycles.samples, scene.cycles.use_denoising = samples, denoised
    scene.cycles.use_adaptive_sampling, scene.view_settings.view_transform = False, "Standard"
    path = Path(bpy.app.tempdir) / "picture.exr"
    save_multilayer(scene, path)
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        names = ["ViewLayer.Combined." + channel for channel in "RGBA"]
        return np.stack([np.asarray(channels[name].pixels) for name in names], -1)


def over_checkers(picture: np.ndarray) -> np.ndarray:
    """Return (H,W,3) uint8 display colors of a linear picture with alpha, over a checkerboard."""
    from feature4x.f4x_core.scene.color import srgb_from_linear

    rows, columns = np.indices(picture.shape[:2]) // CHECKER
    behind = np.where((rows + columns) % 2, LIGHT, DARK)
    light = picture[..., :3] + (1 - picture[..., 3:]) * behind[..., None]
    return np.round(255 * srgb_from_linear(np.clip(light, 0, 1))).astype(np.uint8)
