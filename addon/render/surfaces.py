"""Blender's meshes, curves and text as the core's surfaces: triangles, normals and the plain color of their materials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...f4x_core.scene.color import srgb_from_linear
from ...f4x_core.scene.ground import Surface, Texture

GRAY = (0.8, 0.8, 0.8)
"""Linear color of a surface without a material, Blender's own."""
BASE = {
    "BSDF_PRINCIPLED": "Base Color",
    "BSDF_DIFFUSE": "Color",
    "BSDF_GLOSSY": "Color",
    "SUBSURFACE_SCATTERING": "Color",
}
"""Kinds of shaders and the input that holds their color."""
COLORS = {"FLOAT_COLOR": ("color", 4), "BYTE_COLOR": ("color", 4), "FLOAT_VECTOR": ("vector", 3)}
"""Types of attributes that hold colors: what Blender calls their values, and how many numbers each has."""
DEEP = 8
"""Nodes that are looked through one behind the other."""


@dataclass(frozen=True)
class Look:
    """The part of a material that is shown."""

    color: tuple[float, float, float] = GRAY
    """Linear."""
    glow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Linear light that it gives off."""
    attribute: str = ""
    """Attribute of the mesh that holds the color."""
    image: bpy.types.Image | None = None
    """Image that holds the color."""
    uv_map: str = ""
    """Name of its UV map on the mesh; empty = the mesh's own for renders."""


class Images:
    """Pixels of images, read once each."""

    def __init__(self) -> None:
        """Begin with nothing read."""
        self._read: dict[int, np.ndarray | None] = {}

    def pixels(self, image: bpy.types.Image) -> np.ndarray | None:
        """Return (h,w,3) sRGB, the upper row first; None for an image without any."""
        if image.session_uid not in self._read:
            self._read[image.session_uid] = _pixels(image)
        return self._read[image.session_uid]


def surface_of(item: bpy.types.Object, to_world: np.ndarray, images: Images | None = None) -> Surface | None:
    """Return the evaluated triangles of an object; None for none. Without `images` they have neither normals nor colors."""
    mesh = item.to_mesh()
    try:
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        if not count:
            return None
        points, corners = np.empty(3 * len(mesh.vertices), np.float32), np.empty(3 * count, np.int32)
        mesh.vertices.foreach_get("co", points)
        mesh.loop_triangles.foreach_get("vertices", corners)
        points = points.reshape(-1, 3) @ to_world[:3, :3].T + to_world[:3, 3]
        looks = {} if images is None else _looks(item, mesh, corners, images)
        if "normals" in looks and abs(np.linalg.det(to_world[:3, :3])) > 0:
            looks["normals"] = looks["normals"] @ np.linalg.inv(to_world[:3, :3])
    finally:
        item.to_mesh_clear()
    shown: dict[str, Any] = {"colors": np.tile(srgb_from_linear(np.array(GRAY)), (count, 1))} | looks
    return Surface(triangles=points[corners.reshape(-1, 3)], index=item.pass_index, **shown)


def _looks(item: bpy.types.Object, mesh: bpy.types.Mesh, vertices: np.ndarray, images: Images) -> dict[str, Any]:
    """Return the fields of a `Surface` that say how the triangles with these corners look."""
    count = len(vertices) // 3
    slots, loops = np.empty(count, np.int32), np.empty(3 * count, np.int32)
    mesh.loop_triangles.foreach_get("material_index", slots)
    mesh.loop_triangles.foreach_get("loops", loops)
    normals = np.empty(3 * len(mesh.corner_normals), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    found: dict[str, Any] = {"normals": normals.reshape(-1, 3)[loops].reshape(-1, 3, 3)}
    looks = [look_of(slot.material) for slot in item.material_slots] or [Look()]
    slots = np.minimum(slots, len(looks) - 1)
    found["colors"] = srgb_from_linear(np.array([look.color for look in looks], float))[slots]
    glow = np.array([look.glow for look in looks], float)
    if glow.any():
        found["glow"] = glow[slots]
    for number, look in enumerate(looks):
        own = slots == number
        if look.attribute and own.any():
            values = _at_corners(mesh, look.attribute, vertices, loops)
            if values is not None:
                found["colors"] = np.array(np.broadcast_to(_each_corner(found["colors"]), (count, 3, 3)))
                found["colors"][own] = srgb_from_linear(values.reshape(-1, 3, 3)[own])
    return found | {"textures": _textures(mesh, looks, slots, loops, images)}


def _each_corner(colors: np.ndarray) -> np.ndarray:
    return colors if colors.ndim == 3 else colors[:, None]


def _textures(
    mesh: bpy.types.Mesh, looks: list[Look], slots: np.ndarray, loops: np.ndarray, images: Images
) -> list[Texture]:
    """Return the images on the triangles."""
    found = []
    for slot, look in enumerate(looks):
        own = slots == slot
        layer = mesh.uv_layers.get(look.uv_map) or next((each for each in mesh.uv_layers if each.active_render), None)
        pixels = images.pixels(look.image) if look.image is not None and layer is not None and own.any() else None
        if pixels is not None:
            places = np.empty(2 * len(mesh.loops), np.float32)
            layer.uv.foreach_get("vector", places)
            found.append(Texture(pixels, own, places.reshape(-1, 2)[loops].reshape(-1, 3, 2)))
    return found


def _at_corners(mesh: bpy.types.Mesh, name: str, vertices: np.ndarray, loops: np.ndarray) -> np.ndarray | None:
    """Return (3 T,3) linear colors of an attribute at the corners; None where the mesh has none of that name on them."""
    attribute = mesh.attributes.get(name) if name else mesh.color_attributes.active_color
    rows = {"POINT": vertices, "CORNER": loops}.get(attribute.domain) if attribute is not None else None
    layout = COLORS.get(attribute.data_type) if attribute is not None else None
    if rows is None or layout is None:
        return None
    key, width = layout
    values = np.empty(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get(key, values)
    return values.reshape(-1, width)[rows, :3]


def look_of(material: bpy.types.Material | None) -> Look:
    """Return the color, light and image of a material, as far as its nodes say so plainly; else its color for the viewport."""
    if material is None:
        return Look()
    plain = Look(tuple(material.diffuse_color[:3]))
    if bpy.app.version < (5, 0, 0) and not material.use_nodes:
        return plain
    output = material.node_tree.get_output_node("ALL") if material.node_tree else None
    shader = _shader(output, "Surface") if output is not None else None
    if shader is None:
        return plain
    if shader.type == "EMISSION":
        return Look((0.0, 0.0, 0.0), _light(shader, "Color", "Strength"))
    glow = (
        _light(shader, "Emission Color", "Emission Strength") if shader.type == "BSDF_PRINCIPLED" else (0.0, 0.0, 0.0)
    )
    return _colored(shader.inputs[BASE[shader.type]], glow, plain)


def _source(socket: bpy.types.NodeSocket) -> bpy.types.Node | None:
    """Return the node that a socket gets its value from; None where it has its own."""
    return socket.links[0].from_node if socket.is_linked else None


def _shader(node: bpy.types.Node, name: str, depth: int = 0) -> bpy.types.Node | None:
    """Return the first shader with a color behind an input, also where several are mixed."""
    node = _source(node.inputs[name])
    if node is None or depth > DEEP or node.type in BASE or node.type == "EMISSION":
        return node if node is not None and depth <= DEEP else None
    inputs = [number for number, socket in enumerate(node.inputs) if socket.type == "SHADER"]
    found = (_shader(node, number, depth + 1) for number in inputs)
    return next((each for each in found if each is not None), None)


def _light(shader: bpy.types.Node, color: str, strength: str) -> tuple[float, float, float]:
    """Return linear light that a shader gives off in one color."""
    if color not in shader.inputs or strength not in shader.inputs:
        return (0.0, 0.0, 0.0)
    values = shader.inputs[color].default_value[:3]
    return tuple(value * shader.inputs[strength].default_value for value in values)


def _colored(socket: bpy.types.NodeSocket, glow: tuple[float, float, float], plain: Look) -> Look:
    """Return the look of a shader whose color comes from `socket`: itself, or the nearest node behind it that plainly has one."""
    node = _source(socket)
    if node is None:
        return Look(tuple(socket.default_value[:3]), glow)
    for _ in range(DEEP):
        if node is None:
            break
        if node.type == "TEX_IMAGE" and node.image is not None:
            place = _source(node.inputs["Vector"])
            uv_map = place.uv_map if place is not None and place.type == "UVMAP" else ""
            return Look(plain.color, glow, image=node.image, uv_map=uv_map)
        if node.type in ("ATTRIBUTE", "VERTEX_COLOR"):
            name = node.attribute_name if node.type == "ATTRIBUTE" else node.layer_name
            return Look(plain.color, glow, attribute=name)
        if node.type == "RGB":
            return Look(tuple(node.outputs[0].default_value[:3]), glow)
        linked = [each for each in node.inputs if each.type == "RGBA" and each.is_linked]
        node = _source(linked[0]) if linked else None
    return Look(plain.color, glow)


def _pixels(image: bpy.types.Image) -> np.ndarray | None:
    width, height = image.size
    if not width or not height:  # its file is missing
        return None
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)[::-1]
    rgb = values[..., :3] if image.channels >= 3 else np.repeat(values[..., :1], 3, -1)
    # pixels of 8 bits are what the file holds, others are linear
    is_display = not image.is_float and image.colorspace_settings.name == "sRGB"
    return np.ascontiguousarray(np.clip(rgb if is_display else srgb_from_linear(rgb), 0, 1), np.float32)
