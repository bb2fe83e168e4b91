"""Synthetic clips with truth: a textured room, a subject that moves and deforms, a hand-held camera.

World frame of the truth: Blender's own (metres, z up). Cameras in it are OpenCV cameras (`world_to_camera`).
Everything is lit by one sharp sun plus an emission that stands for sky light, so 16 samples are already clean.

    OUT/images/%05d.png    sRGB, Standard view transform
    OUT/truth/%05d.exr     multilayer float32: Combined, Depth.Z (z depth, 1e10 = nothing), Vector, Position and
                           the object index (`IndexOB.X` from Blender 4.x, `Object Index.X` from 5.x)
    OUT/truth.json         cameras, moving object indices, extra cameras
    OUT/images_left10 ...  the same moments from 10 degrees to the side, on request
    OUT/truth_left10 ...   their passes

Truth flow in pixels (x right, y down): forward t -> t+1 = (-Vector.Z, +Vector.W); backward t -> t-1 = (+Vector.X,
-Vector.Y). The same seed gives the same pictures in one Blender version; cell colours differ between versions.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..f4x_core.errors import F4xError
from ..f4x_core.scene.color import linear_from_srgb
from .axes import camera_path
from .render_settings import save_multilayer, save_png
from .truth import MOVING_INDEX, STATIC_INDEX, render_frames, use_passes, write_facts

FPS = 24
EXTRA_DEGREES = {"left10": -10.0, "right10": 10.0}  # orbit about the vertical through SCENE_CENTRE
EXTRA_STRIDE = 4  # the extra cameras see every 4th moment
SCENE_CENTRE = Vector((0.0, 0.0, 0.75))  # where the subject stays close to, metres
CAMERA_DISTANCE = 4.6  # metres from SCENE_CENTRE
FLOOR_COVER = 0.02  # metres: top of the carpet, on which the subjects move
HANDHELD_STRIDE = 2  # recorded cameras per clip frame (the recording runs at twice our pace)
WALK_SPEED = {"knight": 1.1, "fox": 1.3}  # metres per second, so that the feet do not slide much
SUBJECT_HEIGHT = {"knight": 2.0, "fox": 1.1}  # metres
WALK_ACTION = {"knight": "Walking_A", "fox": "Walk"}

_Triple = tuple[float, float, float]
_Pattern = Callable[["_Nodes", bpy.types.NodeSocket], bpy.types.NodeSocket]  # (nodes, coordinates) -> colour


@dataclass(frozen=True)
class ClipSettings:
    """What to render."""

    scene: str = "procedural"  # procedural, knight or fox
    frames: int = 24  # clip frames, times 0..frames-1
    width: int = 240  # pixels
    height: int = 136  # pixels
    samples: int = 16  # Cycles samples per pixel
    seed: int = 0  # camera jitter, textures, furniture
    assets: Path = Path("assets")  # folder with knight.glb, fox.glb and handheld_camera.json
    extra_cameras: bool = False  # also render EXTRA_DEGREES

    def __post_init__(self) -> None:
        if self.frames < 1 or self.width < 16 or self.height < 16 or self.samples < 1:
            raise F4xError(
                "A clip needs at least 1 frame, 16x16 pixels and 1 sample; raise --frames, --size or --samples."
            )
        needed = [] if self.scene == "procedural" else [f"{self.scene}.glb", "handheld_camera.json"]
        for name in needed:
            if not (self.assets / name).is_file():
                raise F4xError(f"{self.assets / name} is missing; give the folder that holds it with --assets.")


def write_clip(folder: Path, settings: ClipSettings) -> None:
    """Build the scene and render images and truth into `folder`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    random = np.random.default_rng(settings.seed)
    scene = _set_up_render(settings)
    _build_room(random)
    if settings.scene == "procedural":
        _build_deforming_subject(settings.frames)
        poses = _smooth_hand_poses(settings.frames, random)
    else:
        _import_walker(settings)
        poses = _recorded_hand_poses(settings)
    camera = _add_camera(scene, "camera", poses)
    extra = {name: _add_camera(scene, name, _orbited(poses, degrees)) for name, degrees in EXTRA_DEGREES.items()}

    times = np.arange(settings.frames)
    render_frames(folder, scene, times)

    extra_entries = []
    for name, extra_camera in extra.items() if settings.extra_cameras else ():
        scene.camera = extra_camera
        for time in times[::EXTRA_STRIDE]:
            scene.frame_set(int(time))
            save_multilayer(scene, folder / f"truth_{name}" / f"{time:05d}.exr")
            save_png(scene, folder / f"images_{name}" / f"{time:05d}.png")
        path = camera_path(scene, extra_camera, times[::EXTRA_STRIDE])
        extra_entries.append({"name": name, "cameras": path.to_json(), "images": f"images_{name}"})

    write_facts(folder, settings.scene, FPS, camera_path(scene, camera, times), extra_cameras=extra_entries)


def _set_up_render(settings: ClipSettings) -> bpy.types.Scene:
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 0, settings.frames - 1
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = settings.width, settings.height, 100
    render.fps = FPS
    use_passes(scene, settings.samples, settings.seed)
    scene.view_settings.view_transform = "Standard"
    scene.cycles.max_bounces = 0  # direct light only: no noise from bounces

    world = bpy.data.worlds.new("world")
    world.color = (0.0, 0.0, 0.0)
    scene.world = world
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.data.color = 3.8, math.radians(2.0), (1.0, 0.95, 0.86)
    sun.rotation_euler = (math.radians(38), math.radians(-22), 0.0)
    scene.collection.objects.link(sun)
    return scene


# ---------------------------------------------------------------------------------------------- materials


class _Nodes:
    """A node tree with short words for adding and linking."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree

    def add(self, kind: str, inputs: dict | None = None, **properties):
        """Add a node; an input given a socket is linked, given a value is set."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value
        return node

    def ramp(self, factor, colors, constant=False):
        """Spread colours evenly over [0, 1]."""
        node = self.add("ValToRGB", {"Fac": factor})
        ramp = node.color_ramp
        ramp.interpolation = "CONSTANT" if constant else "EASE"
        for i, color in enumerate(colors):
            position = i / (len(colors) if constant else len(colors) - 1)
            element = ramp.elements[i] if i < 2 else ramp.elements.new(position)
            element.position, element.color = position, _linear(color)
        return node.outputs["Color"]

    def noise(self, coordinates, scale, detail=3.0):
        """Fractal noise, 0..1."""
        return self.add("TexNoise", {"Vector": coordinates, "Scale": scale, "Detail": detail}).outputs["Fac"]

    def multiply(self, a, b, amount=1.0):
        """Multiply two colours."""
        node = self.add("Mix", data_type="RGBA", blend_type="MULTIPLY")
        node.inputs[0].default_value = amount
        self.tree.links.new(a, node.inputs[6])
        self.tree.links.new(b, node.inputs[7])
        return node.outputs[2]


def _linear(hex_color: str) -> tuple[float, float, float, float]:
    """sRGB `rrggbb` as the linear RGBA that Blender's sockets want."""
    srgb = np.array([int(hex_color[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return (*linear_from_srgb(srgb).tolist(), 1.0)


def _shade(nodes: _Nodes, color) -> None:
    """Give `color` its light: diffuse under the sun plus an emission that grows towards the sky."""
    tree = nodes.tree
    up = nodes.add(
        "VectorMath", {0: nodes.add("NewGeometry").outputs["Normal"], 1: (0.25, -0.45, 0.7)}, operation="DOT_PRODUCT"
    )
    sky = nodes.add("Math", {0: up.outputs["Value"], 1: 0.2, 2: 0.42}, operation="MULTIPLY_ADD")
    emission = nodes.add("Emission", {"Color": color, "Strength": sky.outputs[0]})
    diffuse = nodes.add("BsdfDiffuse", {"Color": color})
    both = nodes.add("AddShader", {0: emission.outputs[0], 1: diffuse.outputs[0]})
    output = next((n for n in tree.nodes if n.type == "OUTPUT_MATERIAL"), None) or nodes.add("OutputMaterial")
    tree.links.new(both.outputs[0], output.inputs["Surface"])


def _material(name: str, pattern, coordinates: str = "UVMap", offset=(0.0, 0.0, 0.0)) -> bpy.types.Material:
    """Make a material whose colour is `pattern(nodes, vector socket)`, broken up by two scales of noise."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    nodes = _Nodes(material.node_tree)
    attribute = nodes.add("Attribute", attribute_name=coordinates)
    vector = nodes.add("VectorMath", {0: attribute.outputs["Vector"], 1: offset}, operation="ADD").outputs[0]
    color = pattern(nodes, vector)
    for scale, shades in ((1.3, ("8f8a85", "ffffff")), (9.0, ("777777", "ffffff"))):
        color = nodes.multiply(color, nodes.ramp(nodes.noise(vector, scale), shades), 0.75)
    _shade(nodes, color)
    return material


def _planks(nodes, vector):
    node = nodes.add(
        "TexBrick",
        {
            "Vector": vector,
            "Color1": _linear("b98a58"),
            "Color2": _linear("7d5432"),
            "Mortar": _linear("2e1d10"),
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
                "Color1": _linear(first),
                "Color2": _linear(second),
                "Mortar": _linear("d8d0c0"),
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
        inputs = {"Vector": vector, "Scale": scale, "Color1": _linear(first), "Color2": _linear(second)}
        return nodes.add("TexChecker", inputs).outputs["Color"]

    return pattern


# --------------------------------------------------------------------------------------------------- room


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


def _build_room(random: np.random.Generator) -> None:
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


# ------------------------------------------------------------------------------------------------ subjects


def _keyed_times(frames: int) -> range:
    """One key before and one after the clip: the Vector pass looks at both neighbours of a frame."""
    return range(-1, frames + 1)


def _key_linear(datablock: bpy.types.ID, data_path: str, values: dict[int, object]) -> None:
    """Key one property at the given frames; sub-frames are never rendered, so interpolation does not matter."""
    owner = datablock
    *prefix, name = data_path.rsplit(".", 1)
    if prefix:
        owner = datablock.path_resolve(prefix[0])
    for time, value in values.items():
        setattr(owner, name, value)
        datablock.keyframe_insert(data_path, frame=time)


def _build_deforming_subject(frames: int) -> None:
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
    times = _keyed_times(frames)
    phase = {t: t / FPS for t in times}  # seconds
    _key_linear(
        subject, "rotation_euler", {t: (-0.2, 0.12 * math.sin(5 * s), -0.35 + 0.7 * s) for t, s in phase.items()}
    )
    _key_linear(subject, 'modifiers["bend"].angle', {t: 0.45 * math.sin(4.5 * s) for t, s in phase.items()})
    _key_linear(subject, 'modifiers["twist"].angle', {t: 0.3 * math.sin(3.3 * s + 1) for t, s in phase.items()})
    _key_linear(
        mesh.shape_keys, 'key_blocks["swell"].value', {t: 0.5 + 0.5 * math.sin(7 * s) for t, s in phase.items()}
    )
    lowest = {}  # of the deformed body while its origin rests at height 0: hops start and end on the floor
    for t in times:
        bpy.context.scene.frame_set(t)
        lowest[t] = _world_bounds([subject])[0].z
    _key_linear(
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


def _import_walker(settings: ClipSettings) -> None:
    """Import the animated figure, repeat its walk and carry it across the room."""
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(settings.assets / f"{settings.scene}.glb"))
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 0, settings.frames - 1  # the importer sets its own range
    scene.render.fps = FPS
    figure = [o for o in bpy.data.objects if o not in before]
    armature = next(o for o in figure if o.type == "ARMATURE")
    # the importer leaves helpers (bone shapes) and spare props; only what is skinned or worn is the figure
    for item in [o for o in figure if o.type == "MESH" and (o.parent is None or not o.visible_get())]:
        figure.remove(item)
        bpy.data.objects.remove(item)
    _repeat_action(armature, bpy.data.actions[_action_name(WALK_ACTION[settings.scene])])

    for material in {s.material for o in figure if o.type == "MESH" for s in o.material_slots if s.material}:
        principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        nodes = _Nodes(material.node_tree)
        linked = principled.inputs["Base Color"].links
        plain = nodes.add("RGB")
        plain.outputs[0].default_value = principled.inputs["Base Color"].default_value
        _shade(nodes, linked[0].from_socket if linked else plain.outputs[0])
    for item in figure:
        item.pass_index = MOVING_INDEX

    carrier = bpy.data.objects.new("carrier", None)
    scene.collection.objects.link(carrier)
    for root in [o for o in figure if o.parent is None]:
        root.parent = carrier
    scene.frame_set(0)
    lowest, highest = _world_bounds([o for o in figure if o.type == "MESH"])
    carrier.scale = (SUBJECT_HEIGHT[settings.scene] / (highest.z - lowest.z),) * 3
    carrier.rotation_euler.z = math.radians(62)  # the figures face -y; walk to the right and slightly to the camera
    step = WALK_SPEED[settings.scene] / FPS
    direction = Vector((math.sin(carrier.rotation_euler.z), -math.cos(carrier.rotation_euler.z), 0.0))
    middle = 0.5 * (settings.frames - 1)
    floor = Vector((0.0, 0.0, FLOOR_COVER - lowest.z * carrier.scale.z))
    _key_linear(
        carrier, "location", {t: floor + direction * step * (t - middle) for t in _keyed_times(settings.frames)}
    )


def _action_name(wanted: str) -> str:
    """Find an imported action whose name may carry a suffix."""
    names = [a.name for a in bpy.data.actions]
    found = [n for n in names if n == wanted] or [n for n in names if n.split("_Armature")[0] == wanted]
    if not found:
        raise F4xError(f"The imported figure has no action {wanted}; it has {', '.join(sorted(names))}.")
    return found[0]


def _repeat_action(armature: bpy.types.Object, action: bpy.types.Action) -> None:
    """Play `action` over and over, on an NLA strip that starts before the clip."""
    data = armature.animation_data
    data.action = None
    for track in list(data.nla_tracks):
        data.nla_tracks.remove(track)
    length = action.frame_range[1] - action.frame_range[0]
    strip = data.nla_tracks.new().strips.new(action.name, -round(length), action)
    if action.slots and strip.action_slot is None:
        strip.action_slot = action.slots[0]
    strip.repeat = 1000


def _world_bounds(meshes) -> tuple[Vector, Vector]:
    """Lowest and highest corner of the evaluated meshes, world frame."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    corners = []
    for item in meshes:
        evaluated = item.evaluated_get(depsgraph)
        corners += [evaluated.matrix_world @ v.co for v in evaluated.data.vertices]
    points = np.array(corners)
    return Vector(points.min(0)), Vector(points.max(0))


# ------------------------------------------------------------------------------------------------- cameras


def _smooth_hand_poses(frames: int, random: np.random.Generator) -> dict[int, Matrix]:
    """Blender camera-to-world poses: a slow sweep of about a sixth of the distance, with a hand's tremble."""
    times = np.array(_keyed_times(frames))
    tremble = random.normal(size=(len(times) + 8, 6))
    kernel = np.hanning(7) / np.hanning(7).sum()
    tremble = np.stack([np.convolve(c, kernel, "same") for c in tremble.T], 1)[4:-4]
    s = times / max(frames - 1, 1)
    sweep = np.stack([0.8 * (s - 0.5), 0.22 * np.sin(2.2 * s), 0.12 * np.sin(4 * s)], 1)
    position = np.array([0.0, -CAMERA_DISTANCE, 1.45]) + sweep + 0.015 * tremble[:, :3]
    target = np.array(SCENE_CENTRE) + 0.05 * tremble[:, 3:] + np.stack([0.25 * (s - 0.5), 0 * s, 0.1 + 0 * s], 1)
    return {int(t): _looking_at(Vector(p), Vector(q)) for t, p, q in zip(times, position, target, strict=True)}


def _looking_at(position: Vector, target: Vector) -> Matrix:
    rotation = (target - position).to_track_quat("-Z", "Y").to_matrix()
    return Matrix.Translation(position) @ rotation.to_4x4()


def _recorded_hand_poses(settings: ClipSettings) -> dict[int, Matrix]:
    """The recorded cameras, moved and scaled so that the point they look at becomes SCENE_CENTRE.

    The recording (y up, OpenCV cameras: `orientation` = R world to camera, `position` = centre) is played back and
    forth when the clip is longer than it.
    """
    record = json.loads((settings.assets / "handheld_camera.json").read_text())
    position = np.array([c["position"] for c in record])  # (n,3)
    rotation = np.array([c["orientation"] for c in record])  # (n,3,3) world to camera
    axis = rotation[:, 2]  # viewing direction in the world
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]  # (n,3,3) projects away from the ray
    seen = np.linalg.solve(across.sum(0), (across @ position[:, :, None]).sum(0))[:, 0]
    scale = CAMERA_DISTANCE / np.linalg.norm(position - seen, axis=1).mean()

    last = len(record) - 1
    index = {t: last - abs(last - (abs(t) * HANDHELD_STRIDE) % (2 * last)) for t in _keyed_times(settings.frames)}
    mean_axis = axis[list(index.values())].mean(0)
    upright = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)))  # y up -> z up
    turn = Matrix.Rotation(math.atan2(*(upright @ Vector(mean_axis)).xy), 3, "Z") @ upright
    poses = {}
    for time, i in index.items():
        opengl = Matrix(rotation[i].T @ np.diag([1.0, -1.0, -1.0]))
        centre = SCENE_CENTRE + turn @ Vector(scale * (position[i] - seen))
        poses[time] = Matrix.Translation(centre) @ (turn @ opengl).to_4x4()
    return poses


def _orbited(poses: dict[int, Matrix], degrees: float) -> dict[int, Matrix]:
    """Turn every pose about the vertical through SCENE_CENTRE."""
    there = Matrix.Translation(SCENE_CENTRE)
    turn = there @ Matrix.Rotation(math.radians(degrees), 4, "Z") @ there.inverted()
    return {time: turn @ pose for time, pose in poses.items()}


def _add_camera(scene: bpy.types.Scene, name: str, poses: dict[int, Matrix]) -> bpy.types.Object:
    camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    camera.data.sensor_fit, camera.data.sensor_width, camera.data.lens = "HORIZONTAL", 36.0, 32.0
    camera.rotation_mode = "QUATERNION"
    scene.collection.objects.link(camera)
    _key_linear(camera, "location", {t: pose.to_translation() for t, pose in poses.items()})
    _key_linear(camera, "rotation_quaternion", {t: pose.to_quaternion() for t, pose in poses.items()})
    scene.camera = scene.camera or camera
    return camera
