"""What stands in the evaluated Blender scene, as the core's stage: Gaussians after geometry nodes, surfaces, the world."""

from dataclasses import replace

import bpy
import numpy as np

from ..f4x_core.edit.resolve import named
from ..f4x_core.scene.color import srgb_from_linear
from ..f4x_core.scene.cryptomatte import identify
from ..f4x_core.scene.stage import Cloud, Surface
from . import session
from .gaussian_attributes import FITTED_FOCAL
from .point_cloud import read_attribute

ENGINE = "FEATURE4X"
"""Identifier of the render engine."""
HIDDEN = "f4x_hidden"
"""BOOLEAN: points that no picture shows."""
LAYERS = {"latent": "f4x_latent", "selection": ".selection", "score": "f4x_score"}
"""Passes of the stage and the point attributes they show."""
GREY = (0.8, 0.8, 0.8)
"""Linear colour of a surface without a material, Blender's own."""
SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")


class Mattes:
    """What mattes tell apart: objects, in scenes the selections that edits named, and collections. Gathers their names."""

    def __init__(self):
        self.names: dict[str, dict[str, None]] = {"object": {}, "collection": {}}
        self._selected: dict[str, dict[str, np.ndarray]] = {}

    def of(self, owner: bpy.types.Object) -> dict[str, int]:
        """Layer -> id of an object as a whole."""
        collections = owner.users_collection
        return {
            "object": self._id("object", owner.name),
            "collection": self._id("collection", collections[0].name) if collections else 0,
        }

    def of_points(self, owner: bpy.types.Object, data: bpy.types.PointCloud) -> dict[str, np.ndarray]:
        """Layer -> (N,) id of each point of an object's evaluated `data`; of several selections the last one counts."""
        ids = {layer: np.full(len(data.points), own, np.uint32) for layer, own in self.of(owner).items()}
        root, gid = session.root_of(owner), read_attribute(data, "gid")
        if root is not None and gid is not None:
            shown = session.shown(root)
            if root.name not in self._selected:
                self._selected[root.name] = {name: found.chosen for name, found in named(shown.scene).items()}
            row, known = shown.rows_of(gid)
            for name, chosen in self._selected[root.name].items():
                ids["object"][known & chosen[row]] = self._id("object", name)
        return ids

    def _id(self, layer: str, name: str) -> int:
        self.names[layer][name] = None
        return identify(name)


def stage(
    depsgraph: bpy.types.Depsgraph, view: bpy.types.SpaceView3D | None = None, mattes: Mattes | None = None
) -> tuple[list[Cloud], list[Surface]]:
    """Every visible point cloud that holds Gaussians and every visible surface, instances too, in Blender's world.

    `view` is the viewport that looks, where one does: it may hide objects of its own. `mattes`: where those are wanted.
    """
    clouds: list[Cloud] = []
    surfaces: list[Surface] = []
    for instance in depsgraph.object_instances:
        item = instance.object
        owner = (instance.parent or item).original
        hidden = not instance.show_self or not item.visible_camera
        if hidden or (view is not None and not owner.visible_in_viewport_get(view)):
            continue
        to_world = np.array(instance.matrix_world)
        key = f"{owner.name}/{item.name}/{tuple(instance.persistent_id) if instance.is_instance else ''}"
        if item.type == "POINTCLOUD":
            cloud = _cloud(item.data, to_world, item.pass_index)
            if cloud is not None:
                ids = mattes.of_points(item.original, item.data) if mattes else {}
                clouds.append(replace(cloud, key=key, mattes=ids))
        elif item.type in SOLID:
            surface = surface_of(item, to_world)
            if surface is not None:
                surfaces.append(replace(surface, key=key, mattes=mattes.of(item.original) if mattes else {}))
    return clouds, surfaces


def world_color(world: bpy.types.World | None) -> np.ndarray:
    """(3,) sRGB of a world of one colour: its Background node, else its viewport colour; black without a world."""
    if world is None:
        return np.zeros(3)
    color, strength = world.color, 1.0
    if bpy.app.version >= (5, 0, 0) or world.use_nodes:
        output = world.node_tree.get_output_node("ALL")
        links = output.inputs["Surface"].links if output else ()
        node = links[0].from_node if links else None
        if node is not None and node.type == "BACKGROUND" and not node.inputs["Color"].is_linked:
            color, strength = node.inputs["Color"].default_value[:3], node.inputs["Strength"].default_value
    return srgb_from_linear(np.array(color) * strength)


def _cloud(data: bpy.types.PointCloud, to_world: np.ndarray, index: int) -> Cloud | None:
    """The Gaussians of a point cloud; None where it holds none."""
    found = {name: read_attribute(data, name) for name in ("position", "rotation", "scale", "radiance:base")}
    if any(values is None or not len(values) for values in found.values()):
        return None
    base = found["radiance:base"]
    higher = []
    while (coefficients := read_attribute(data, f"radiance:sh_{len(higher)}")) is not None:
        higher.append(coefficients)
    whole = (int((1 + len(higher)) ** 0.5)) ** 2  # an artist may have removed some
    hidden = read_attribute(data, HIDDEN)
    layers = {name: read_attribute(data, attribute) for name, attribute in LAYERS.items()}
    return Cloud(
        means=found["position"],
        quats=found["rotation"],
        scales=found["scale"],
        opacities=np.clip(base[:, 3], 0, 1) * (1 if hidden is None else ~hidden.astype(bool)),
        sh=np.stack([base[:, :3], *higher[: whole - 1]], 1),
        turn=read_attribute(data, "turn"),
        to_world=to_world,
        index=index,
        fitted_focal=data.get(FITTED_FOCAL),
        layers={name: values.reshape(len(base), -1) for name, values in layers.items() if values is not None},
    )


def surface_of(item: bpy.types.Object, to_world: np.ndarray) -> Surface | None:
    """The evaluated triangles of an object; None where it has none."""
    mesh = item.to_mesh()
    try:
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        if not count:
            return None
        points = np.empty(3 * len(mesh.vertices), np.float32)
        corners, slots = np.empty(3 * count, np.int32), np.empty(count, np.int32)
        mesh.vertices.foreach_get("co", points)
        mesh.loop_triangles.foreach_get("vertices", corners)
        mesh.loop_triangles.foreach_get("material_index", slots)
    finally:
        item.to_mesh_clear()
    points = points.reshape(-1, 3) @ to_world[:3, :3].T + to_world[:3, 3]
    materials = [slot.material for slot in item.material_slots] or [None]
    colors = np.array([GREY if material is None else material.diffuse_color[:3] for material in materials])
    return Surface(
        triangles=points[corners.reshape(-1, 3)],
        colors=srgb_from_linear(colors)[np.minimum(slots, len(materials) - 1)],
        index=item.pass_index,
        holdout=item.is_holdout,
    )
