"""The room of rendered clips: textured walls and furniture, and who moves in it (a soft head, or a walking figure)."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from .figures import import_model, world_bounds
from .nodes import FPS, Nodes, key_linear, keyed_times, linear_color, shade
from .truth import MOVING_INDEX, STATIC_INDEX

FLOOR_COVER = 0.02  # metres: top of the carpet, on which the subjects move
WALK_SPEED = {"knight": 1.1, "fox": 1.3}  # metres per second, so that the feet do not slide much
SUBJECT_HEIGHT = {"knight": 2.0, "fox": 1.1}  # metres
WALK_ACTION = {"knight": "Walking_A", "fox": "Walk"}

_Triple = tuple[float, float, float]
_Pattern = Callable[["Nodes", bpy.types.NodeSocket], bpy.types.NodeSocket]  # (nodes, coordinates) -> colour


def _material(name: str, pattern, coordinates: str = "UVMap", offset=(0.0, 0.0, 0.0)) -> bpy.types.Material:
    """Make a material whose colour is `pattern(nodes, vector socket)`, broken up by two scales of noise."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    nodes = Nodes(material.node_tree)
    attribute = nodes.add("Attribute", attribute_name=coordinates)
    vector = nodes.add("VectorMath", {0: attribute.outputs["Vector"], 1: offset}, operation="ADD").outputs[0]
    color = pattern(nodes, vector)
    for scale, shades in ((1.3, ("8f8a85", "ffffff")), (9.0, ("777777", "ffffff"))):
        color = nodes.multiply(color, nodes.ramp(nodes.noise(vector, scale), shades), 0.75)
    shade(nodes, color)
    return material


def _planks(nodes, vector):
    node = nodes.add(
        "TexBrick",
        {
            "Vector": vector,
            "Color1": linear_color("b98a58"),
            "Color2": linear_color("7d5432"),
            "Mortar": linear_color("2e1d10"),
            "Scale": 1.0,
            "Mortar Size": 0.012,
            "Brick Width": 1.1,
            "Row Height": 0.24,
        },
    )
    stretched = nodes.add("VectorMath", {0: vector, 1: (2.0, 22.0, 1.0)}, operation="MULTIPLY").outputs[0]
    return nodes.multiply(node.outputs["Color"], nodes.ramp(nodes.noise(stretched, 1.0), ("5a4636", "ffffff")))


def _bricks(first: str, second: str):
    def pattern(nodes, vector):
        return nodes.add(
            "TexBrick",
            {
                "Vector": vector,
                "Color1": linear_color(first),
                "Color2": linear_color(second),
                "Mortar": linear_color("d8d0c0"),
                "Scale": 1.0,
                "Mortar Size": 0.02,
                "Brick Width": 0.52,
                "Row Height": 0.24,
            },
        ).outputs["Color"]

    return pattern


def _cells(scale: float, *colors: str):
    def pattern(nodes, vector):
        cell = nodes.add("TexVoronoi", {"Vector": vector, "Scale": scale})
        return nodes.ramp(cell.outputs["Color"], colors, constant=True)

    return pattern


def _clouds(scale: float, *colors: str):
    return lambda nodes, vector: nodes.ramp(nodes.noise(vector, scale, 4.0), colors)


def _checker(scale: float, first: str, second: str):
    def pattern(nodes, vector):
        inputs = {"Vector": vector, "Scale": scale, "Color1": linear_color(first), "Color2": linear_color(second)}
        return nodes.add("TexChecker", inputs).outputs["Color"]

    return pattern


def _box(name, centre: Sequence, size: Sequence, material, turn_degrees=0.0, casts_shadow=True) -> bpy.types.Object:
    """Add a box whose UV are metres on every face (so textures never stretch)."""
    half = Vector(size) / 2
    vertices, uvs = [], []
    for axis in range(3):
        u, v = ((1, 2), (0, 2), (0, 1))[axis]
        for side in (-1, 1):
            for du, dv in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                corner = [0.0] * 3
                corner[axis], corner[u], corner[v] = side * half[axis], du * half[u], dv * half[v]
                vertices.append(corner)
                uvs.append((corner[u] + 3.7 * axis, corner[v]))
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], [tuple(range(4 * i, 4 * i + 4)) for i in range(6)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", np.ravel(uvs))
    mesh.materials.append(material)
    box = bpy.data.objects.new(name, mesh)
    box.location, box.rotation_euler.z = centre, math.radians(turn_degrees)
    box.pass_index = STATIC_INDEX
    box.visible_shadow = casts_shadow
    bpy.context.scene.collection.objects.link(box)
    return box


def build_room(random: np.random.Generator) -> None:
    """Floor, four walls, a carpet, pictures and boxes."""

    def offset():
        return (*random.uniform(0, 20, 2).tolist(), 0.0)

    red, green = _bricks("a8523c", "c77f5a"), _cells(2.6, "3f6b58", "5f8f6b", "2f4f58", "86a873", "c9b26b")
    blue = _cells(3.2, "34507c", "5f86b0", "26344f", "9db4c9", "c98f6b")
    _box("floor", (0, -2, -0.05), (10, 12, 0.1), _material("planks", _planks, offset=offset()))
    walls: tuple[tuple[str, _Triple, _Triple, _Pattern], ...] = (
        ("back wall", (0, 2.6, 2), (10, 0.1, 4.2), red),
        ("left wall", (-4, -2, 2), (0.1, 12, 4.2), green),
        ("right wall", (4, -2, 2), (0.1, 12, 4.2), blue),
        ("front wall", (0, -8, 2), (10, 0.1, 4.2), red),
    )
    for name, centre, size, pattern in walls:
        _box(name, centre, size, _material(name, pattern, offset=offset()), casts_shadow=False)
    carpet = _material("carpet", _cells(3.0, "7a2f3a", "c9a15a", "2f3f5f", "e0d2b0", "8a4a3a"), offset=offset())
    _box("carpet", (0.1, -0.3, FLOOR_COVER / 2), (3.4, 2.6, FLOOR_COVER), carpet, 8)

    pictures: tuple[tuple[_Triple, _Triple, _Pattern], ...] = (
        ((-1.9, 2.52, 1.75), (1.3, 0.06, 0.95), _clouds(3.0, "1d3b6f", "e8b04a", "d94f3d", "f5efe0", "2a6f6f")),
        ((0.35, 2.52, 2.05), (0.95, 0.06, 1.2), _checker(4.2, "f0e6d0", "2c4a3e")),
        ((2.2, 2.52, 1.7), (1.4, 0.06, 1.0), _cells(5.0, "e07a5f", "3d405b", "81b29a", "f2cc8f", "f4f1de")),
    )
    for i, (centre, size, pattern) in enumerate(pictures):
        _box(f"picture {i}", centre, size, _material(f"picture {i}", pattern, offset=offset()))

    furniture: tuple[tuple[_Triple, _Triple, float, _Pattern], ...] = (
        ((-2.5, 1.5, 0.45), (1.0, 0.9, 0.9), 14, _checker(4.0, "d9a441", "5b3a29")),
        ((-2.35, 1.4, 1.15), (0.55, 0.5, 0.5), 40, _clouds(5.0, "23395b", "59c9a5", "fffd98", "b9e3c6")),
        ((2.5, 1.3, 0.6), (0.9, 1.0, 1.2), -18, _bricks("4d7298", "77a6b6")),
        ((2.75, -0.7, 0.3), (0.7, 0.7, 0.6), 25, _cells(7.0, "ef476f", "ffd166", "06d6a0", "118ab2", "f7f0e0")),
        ((-2.6, -0.9, 0.25), (0.8, 0.6, 0.5), -30, _clouds(6.0, "5f0f40", "fb8b24", "e9e3c9", "0f4c5c")),
        ((0.9, 1.9, 0.35), (0.8, 0.6, 0.7), 5, _checker(6.0, "efe9dc", "9a3b3b")),
    )
    for i, (centre, size, turn, pattern) in enumerate(furniture):
        placed = Vector(centre) + Vector((*random.uniform(-0.12, 0.12, 2), 0.0))
        turned = turn + random.uniform(-8, 8)
        _box(f"box {i}", placed, size, _material(f"box {i}", pattern, offset=offset()), turned)


def build_deforming_subject(frames: int) -> None:
    """Add a patched monkey head that hops across the carpet, turns, bends and swells (modifiers + shape key)."""
    bpy.ops.mesh.primitive_monkey_add()
    subject = bpy.context.object
    subject.pass_index = MOVING_INDEX
    mesh = subject.data
    rest = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", rest)
    mesh.attributes.new("rest", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", rest)  # textures stick to the skin

    subject.shape_key_add(name="basis")
    swell = subject.shape_key_add(name="swell")
    swollen = rest.reshape(-1, 3) * np.array([1.25, 1.1, 0.8], np.float32)
    swell.data.foreach_set("co", swollen.ravel())
    bend = subject.modifiers.new("bend", "SIMPLE_DEFORM")
    bend.deform_method, bend.deform_axis = "BEND", "Z"
    twist = subject.modifiers.new("twist", "SIMPLE_DEFORM")
    twist.deform_method, twist.deform_axis = "TWIST", "Z"
    smooth = subject.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 2
    for polygon in mesh.polygons:
        polygon.use_smooth = True
    patches = _cells(5.0, "e4572e", "f3a712", "f0e9d2", "29335c", "669bbc", "a8c686")
    mesh.materials.append(_material("skin", patches, "rest", (7.3, 2.1, 5.0)))

    subject.scale = (0.78,) * 3
    times = keyed_times(frames)
    phase = {t: t / FPS for t in times}  # seconds
    key_linear(
        subject, "rotation_euler", {t: (-0.2, 0.12 * math.sin(5 * s), -0.35 + 0.7 * s) for t, s in phase.items()}
    )
    key_linear(subject, 'modifiers["bend"].angle', {t: 0.45 * math.sin(4.5 * s) for t, s in phase.items()})
    key_linear(subject, 'modifiers["twist"].angle', {t: 0.3 * math.sin(3.3 * s + 1) for t, s in phase.items()})
    key_linear(mesh.shape_keys, 'key_blocks["swell"].value', {t: 0.5 + 0.5 * math.sin(7 * s) for t, s in phase.items()})
    lowest = {}  # of the deformed body while its origin rests at height 0: hops start and end on the floor
    for t in times:
        bpy.context.scene.frame_set(t)
        lowest[t] = world_bounds([subject])[0].z
    key_linear(
        subject,
        "location",
        {
            t: (
                -0.75 + 1.5 * s,
                -0.25 + 0.3 * math.sin(2.5 * s),
                FLOOR_COVER - lowest[t] + 0.22 * abs(math.sin(3.6 * s)),
            )
            for t, s in phase.items()
        },
    )


def import_walker(figure_name: str, assets: Path, frames: int) -> None:
    """Import the animated figure `figure_name.glb`, repeat its walk and carry it across the room."""
    model = import_model(assets / f"{figure_name}.glb", MOVING_INDEX, frames)
    model.play(WALK_ACTION[figure_name])
    bpy.context.scene.frame_set(0)
    lowest, highest = world_bounds(model.meshes)
    carrier = model.carrier
    carrier.scale = (SUBJECT_HEIGHT[figure_name] / (highest.z - lowest.z),) * 3
    carrier.rotation_euler.z = math.radians(62)  # the figures face -y; walk to the right and slightly to the camera
    step = WALK_SPEED[figure_name] / FPS
    direction = Vector((math.sin(carrier.rotation_euler.z), -math.cos(carrier.rotation_euler.z), 0.0))
    middle = 0.5 * (frames - 1)
    floor = Vector((0.0, 0.0, FLOOR_COVER - lowest.z * carrier.scale.z))
    key_linear(carrier, "location", {t: floor + direction * step * (t - middle) for t in keyed_times(frames)})
