"""Open-air scenes of rendered clips, built from their spec: ground to the horizon, sky, textured solids that stand or move."""

import math

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ..f4x_core.clip.rendered_motion import body_poses
from ..f4x_core.clip.rendered_scenes import Body, RenderedScene
from ..f4x_core.clip.rendered_textures import SIZE, texture
from .nodes import FPS, Nodes, key_linear, keyed_times, linear_color, shade
from .truth import MOVING_INDEX, STATIC_INDEX

RINGS = (0.0, 9.0, 24.0, 70.0, 260.0)
"""Radii of the ground's rings, metres: each has its texture as many times larger as it is farther, so none is grain."""
RING_TEXTURE = (3.5, 11.0, 35.0, 120.0)
"""Metres that one tile of the texture covers in each ring."""
GROUND_STRENGTH, HILL_STRENGTH = 0.5, 0.3
"""Contrast of the patterns of ground and hills, less than that of solids."""
TILE = 1.5
"""The same on solids."""
HILLS = (150.0, 16.0)
"""Distance and height of the hills at the horizon, metres."""
WALL = (4.2, 16.0, 2.6)
"""Distance behind the focus, width and height of a yard's wall, metres."""
NEAR_PROPS, FAR_PROPS = (3.2, 9.0), (12.0, 45.0)
"""Distances from the focus between which props stand; every third is a far and large one."""
FAR_SCALE = 4.0
"""Far props are so many times larger."""
SKY = ("6f9fd8", "d9e6ee")
"""Overhead and at the horizon."""


def build_field(spec: RenderedScene, frames: int, seed: int) -> None:
    """Ground, sky, hills, wall, props and bodies of `spec`."""
    random = np.random.default_rng([seed, spec.look, 3])
    first = int(random.integers(1000))
    _build_sky(first)
    for number, (inner, outer, tile) in enumerate(zip(RINGS, RINGS[1:], RING_TEXTURE, strict=False)):
        pattern = texture(first + number, ("patches", "clouds")[number % 2], GROUND_STRENGTH * spec.contrast)
        _build_ring(inner, outer, _material(f"ground {number}", pattern, tile))
    _build_hills(_material("hills", texture(first + 4, "clouds", HILL_STRENGTH), 60.0), random)
    if spec.setting == "yard":
        wall = Body("box", (WALL[1], 0.3, WALL[2]), first + 5, (0.0, WALL[0]))
        _place(_solid("wall", wall, STATIC_INDEX, spec.contrast), wall)
    for number in range(spec.props):
        prop = _prop(number, spec, random)
        _place(_solid(f"prop {number}", prop, STATIC_INDEX, spec.contrast), prop)
    build_bodies(spec, frames)


def build_bodies(spec: RenderedScene, frames: int) -> None:
    """The bodies of `spec`, keyed for `frames` frames."""
    for number, body in enumerate(spec.bodies):
        if body.way is None:
            _place(_solid(f"body {number}", body, STATIC_INDEX, spec.contrast), body)
        else:
            _move(_solid(f"body {number}", body, MOVING_INDEX, spec.contrast), body, frames)


def _material(name: str, pattern: np.ndarray, tile: float) -> bpy.types.Material:
    """The sRGB `pattern` (SIZE,SIZE,3) on every side of an object, one tile of it `tile` metres large."""
    image = bpy.data.images.new(name, SIZE, SIZE)
    pixels = np.ones((SIZE, SIZE, 4), np.float32)
    pixels[..., :3] = pattern
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    nodes = Nodes(material.node_tree)
    place = nodes.add("TexCoord").outputs["Object"]
    scaled = nodes.add("VectorMath", {0: place, 1: (1 / tile,) * 3}, operation="MULTIPLY").outputs[0]
    pattern = nodes.add("TexImage", {"Vector": scaled}, image=image, projection="BOX", projection_blend=0.1)
    shade(nodes, pattern.outputs["Color"])
    return material


def _add(name: str, mesh: bpy.types.Mesh, material: bpy.types.Material, index: int) -> bpy.types.Object:
    mesh.materials.append(material)
    item = bpy.data.objects.new(name, mesh)
    item.pass_index = index
    bpy.context.scene.collection.objects.link(item)
    return item


def _build_ring(inner: float, outer: float, material: bpy.types.Material, sides: int = 64) -> None:
    """A flat ring of the ground about the origin, z = 0."""
    angles = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], 1)
    mesh = bpy.data.meshes.new("ground")
    if inner == 0:
        mesh.from_pydata((outer * circle).tolist(), [], [tuple(range(sides))])
    else:
        after = [(i + 1) % sides for i in range(sides)]
        faces = [(i, sides + i, sides + j, j) for i, j in enumerate(after)]
        mesh.from_pydata(np.concatenate([inner * circle, outer * circle]).tolist(), [], faces)
    _add("ground", mesh, material, STATIC_INDEX)


def _build_hills(material: bpy.types.Material, random: np.random.Generator, sides: int = 48) -> None:
    """A ring of hills as the distant background."""
    distance, height = HILLS
    angles = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    circle = distance * np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], 1)
    tops = circle + np.stack([np.zeros(sides), np.zeros(sides), height * random.uniform(0.2, 1.0, sides)], 1)
    mesh = bpy.data.meshes.new("hills")
    faces = [(i, (i + 1) % sides, sides + (i + 1) % sides, sides + i) for i in range(sides)]
    mesh.from_pydata(np.concatenate([circle, tops]).tolist(), [], faces)
    _add("hills", mesh, material, STATIC_INDEX)


def _build_sky(seed: int) -> None:
    """A sky that is brighter towards the horizon, with soft clouds; it gives no light of its own."""
    world = bpy.context.scene.world
    world.use_nodes = True
    world.node_tree.nodes.clear()
    nodes = Nodes(world.node_tree)
    direction = nodes.add("TexCoord").outputs["Generated"]
    up = nodes.add("SeparateXYZ", {0: direction}).outputs["Z"]
    blue = nodes.add("Mix", {0: up}, data_type="RGBA", clamp_factor=True)
    blue.inputs[6].default_value, blue.inputs[7].default_value = linear_color(SKY[1]), linear_color(SKY[0])
    moved = nodes.add("VectorMath", {0: direction, 1: (seed % 17, 0.0, 0.0)}, operation="ADD").outputs[0]
    flat = nodes.add("VectorMath", {0: moved, 1: (3.0, 3.0, 9.0)}, operation="MULTIPLY").outputs[0]
    clouds = nodes.ramp(nodes.noise(flat, 1.0, 3.0), ("000000", "202020", "ffffff"))
    sky = nodes.add("Mix", {0: clouds}, data_type="RGBA")
    nodes.tree.links.new(blue.outputs[2], sky.inputs[6])
    sky.inputs[7].default_value = linear_color("f7f7f5")
    seen = nodes.add("LightPath").outputs["Is Camera Ray"]
    background = nodes.add("Background", {"Color": sky.outputs[2], "Strength": seen})
    output = nodes.add("OutputWorld")
    nodes.tree.links.new(background.outputs[0], output.inputs["Surface"])


def _prop(number: int, spec: RenderedScene, random: np.random.Generator) -> Body:
    """A random prop that is not between the camera and the focus; distant props are large."""
    far = number % 3 == 2
    nearest, farthest = FAR_PROPS if far else NEAR_PROPS
    distance = random.uniform(nearest, farthest)
    # behind the focus, or to the sides: never in the quarter where the camera moves
    angle = math.radians(random.uniform(-25, 205))
    if spec.setting == "yard" and not far:
        angle = math.radians(random.choice([random.uniform(-20, 35), random.uniform(145, 200)]))
    scale = FAR_SCALE if far else 1.0
    size = scale * random.uniform((0.5, 0.5, 0.8), (1.3, 1.3, 2.2))
    place = distance * np.array([math.cos(angle), math.sin(angle)])
    shape = ("box", "cylinder", "box", "cone")[number % 4]
    return Body(shape, tuple(size), int(random.integers(1000)), tuple(place), float(random.uniform(0, 90)))


def _solid(name: str, body: Body, index: int, contrast: float) -> bpy.types.Object:
    """The body's mesh about its centre, textured."""
    shape = bmesh.new()
    if body.shape == "box":
        bmesh.ops.create_cube(shape, size=1.0)
    elif body.shape == "ball":
        bmesh.ops.create_icosphere(shape, subdivisions=4, radius=0.5)
    elif body.shape in ("cylinder", "cone"):
        top = 0.5 if body.shape == "cylinder" else 0.02
        bmesh.ops.create_cone(shape, cap_ends=True, segments=32, radius1=0.5, radius2=top, depth=1.0)
    else:
        bmesh.ops.create_monkey(shape)
    points = np.array([vertex.co for vertex in shape.verts])
    low, high = points.min(0), points.max(0)
    for vertex, point in zip(shape.verts, (points - (low + high) / 2) / (high - low) * body.size, strict=True):
        vertex.co = point
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    if body.shape in ("ball", "head"):
        for polygon in mesh.polygons:
            polygon.use_smooth = True
    large = max(body.size) > FAR_SCALE
    return _add(
        name,
        mesh,
        _material(name, texture(body.texture, strength=contrast), TILE * (FAR_SCALE if large else 1.0)),
        index,
    )


def _place(item: bpy.types.Object, body: Body) -> None:
    """Stand a body on the ground."""
    turn = Matrix.Rotation(math.radians(body.turned), 4, "Z")
    item.matrix_world = Matrix.Translation((*body.place, body.size[2] / 2)) @ turn


def _move(item: bpy.types.Object, body: Body, frames: int) -> None:
    """Key a body along its way."""
    assert body.way is not None
    corners = np.array([vertex.co for vertex in item.data.vertices])
    times = np.array(keyed_times(frames))
    places, turns = body_poses(body.way, corners, times / max(frames - 1, 1), frames / FPS)
    start = Quaternion((0.0, 0.0, 1.0), math.radians(body.turned))
    item.rotation_mode = "QUATERNION"
    key_linear(item, "location", {int(t): Vector(place) for t, place in zip(times, places, strict=True)})
    key_linear(
        item, "rotation_quaternion", {int(t): Quaternion(turn) @ start for t, turn in zip(times, turns, strict=True)}
    )
