"""Rigged figures of rendered clips: imported, lit like everything else, carried along their way, their joints read off."""

import math
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Quaternion, Vector

from ..f4x_core.clip.rendered_motion import body_poses
from ..f4x_core.clip.rendered_scenes import Figure
from ..f4x_core.errors import F4xError
from ..f4x_core.priors.joints import JOINTS, NAMES
from .nodes import FPS, Nodes, key_linear, keyed_times, linear_color, shade

_Place = tuple[float, float, float]
Rig = dict[str, tuple[str, _Place | None]]
"""Joint of `priors.joints` -> bone, and where on it: a place of the model at rest, None = where the bone begins."""

LEFT_OUT = ("1H_Sword", "2H_Sword", "Badge_Shield", "Rectangle_Shield", "Round_Shield", "Spike_Shield", "Knight_Helmet")
"""Beginnings of names of meshes that people do not carry: all weapons of the knight at once, and what hides his face."""


def _both_sides(right: Rig, left_of: dict[str, str]) -> Rig:
    """The joints of the right side and their mirror images, for bones whose names differ by `left_of`."""
    mirrored: Rig = {}
    for joint, (bone, place) in right.items():
        for old, new in left_of.items():
            bone = bone.replace(old, new)
        left = joint.replace("right", "left")
        mirrored[left] = (bone, None if place is None else (-place[0], *place[1:]))
    return right | mirrored


RIGS: dict[str, Rig] = {
    "knight": {"nose": ("head", (0.0, -0.53, 1.51))}
    | _both_sides(
        {
            "right eye": ("head", (-0.2, -0.42, 1.61)),
            "right ear": ("head", (-0.5, 0.01, 1.5)),
            "mouth right": ("head", (-0.13, -0.42, 1.42)),
            "right shoulder": ("upperarm.r", None),
            "right elbow": ("lowerarm.r", None),
            "right wrist": ("wrist.r", None),
            "right index finger": ("hand.r", (-0.96, 0.0, 1.107)),
            "right hip": ("upperleg.r", None),
            "right knee": ("lowerleg.r", None),
            "right ankle": ("foot.r", None),
            "right heel": ("foot.r", (-0.171, 0.13, 0.02)),
            "right toes": ("toes.r", (-0.171, -0.29, 0.02)),
        },
        {".r": ".l"},
    ),
    "cesium_man": {"nose": ("Skeleton_neck_joint_2", (0.0, -0.13, 1.31))}
    | _both_sides(
        {
            "right eye": ("Skeleton_neck_joint_2", (-0.06, -0.125, 1.36)),
            "right ear": ("Skeleton_neck_joint_2", (-0.165, 0.0, 1.33)),
            "mouth right": ("Skeleton_neck_joint_2", (-0.05, -0.125, 1.26)),
            "right shoulder": ("Skeleton_arm_joint_R", None),
            "right elbow": ("Skeleton_arm_joint_R__2_", None),
            "right wrist": ("Skeleton_arm_joint_R__3_", None),
            "right index finger": ("Skeleton_arm_joint_R__3_", (-0.56, -0.16, 0.79)),
            "right hip": ("leg_joint_R_1", None),
            "right knee": ("leg_joint_R_2", None),
            "right ankle": ("leg_joint_R_3", None),
            "right heel": ("leg_joint_R_3", (-0.083, 0.075, 0.02)),
            "right toes": ("leg_joint_R_5", (-0.083, -0.17, 0.02)),
        },
        # the arms' bones are counted from the body on the right side, and towards it on the left one
        {"R__3_": "L__2_", "R__2_": "L__3_", "arm_joint_R": "arm_joint_L__4_", "leg_joint_R": "leg_joint_L"},
    ),
}
"""Model -> its joints. The models look towards -y, so that their right side is at negative x."""


STANDS_FOR = {
    f"{side} {of}": f"{side} {other}"
    for side in ("left", "right")
    for of, other in {
        "eye inner": "eye",
        "eye outer": "eye",
        "thumb": "index finger",
        "little finger": "index finger",
    }.items()
}
"""Joint that no rig has -> the one beside it, whose place it gets."""


CLOTHES = ("c68863", "2b1d14", "7d3b3b", "2e3d5c", "4a3524")
"""Skin, hair, shirt, trousers, shoes."""


@dataclass(frozen=True)
class Model:
    """An imported figure."""

    carrier: bpy.types.Object
    """Empty at the origin of the model, which everything else hangs on."""
    armature: bpy.types.Object
    meshes: list[bpy.types.Object]
    actions: list[bpy.types.Action]
    """The figure's own."""

    def play(self, name: str, pace: float = 1.0) -> None:
        """Play an action over and over, `pace` times as fast, on an NLA strip that starts before the clip."""
        action = self._action(name)
        data = self.armature.animation_data
        data.action = None
        for track in list(data.nla_tracks):
            data.nla_tracks.remove(track)
        length = action.frame_range[1] - action.frame_range[0]
        strip = data.nla_tracks.new().strips.new(action.name, -round(length), action)
        if action.slots and strip.action_slot is None:
            strip.action_slot = action.slots[0]
        strip.scale = 1 / pace
        strip.repeat = 1000

    def _action(self, wanted: str) -> bpy.types.Action:
        """The action of that name, which may carry a suffix of the importer."""
        for strip in (str, lambda name: name.split("_Armature")[0], lambda name: name.rsplit(".", 1)[0]):
            found = [action for action in self.actions if strip(action.name) == wanted]
            if found:
                return found[0]
        names = ", ".join(sorted(action.name for action in self.actions))
        raise F4xError(f"The imported figure has no action {wanted}; it has {names}.")


@dataclass(frozen=True)
class BuiltFigure:
    """A person of the open scene."""

    model: str
    index: int
    """In the object index pass."""
    height: float
    """Metres."""
    armature: bpy.types.Object

    def joints(self) -> np.ndarray:
        """World positions (33,3) of its joints at the current frame."""
        found = np.full((JOINTS, 3), np.nan)
        for joint, (name, place) in RIGS[self.model].items():
            bone, rest = self.armature.pose.bones[name], self.armature.data.bones[name]
            point = bone.head
            if place is not None:  # carried by the bone
                at_rest = self.armature.matrix_local.inverted() @ Vector(place)
                point = bone.matrix @ rest.matrix_local.inverted() @ at_rest
            found[NAMES.index(joint)] = self.armature.matrix_world @ point
        for joint, other in STANDS_FOR.items():
            found[NAMES.index(joint)] = found[NAMES.index(other)]
        return found


def build_figure(figure: Figure, index: int, assets: Path, frames: int) -> BuiltFigure:
    """Import the figure's model at its height, and key it along its way."""
    model = import_model(assets / f"{figure.model}.glb", index, frames, LEFT_OUT)
    model.armature.data.pose_position = "REST"
    bpy.context.view_layer.update()
    lowest, highest = world_bounds(model.meshes)
    if figure.model == "cesium_man":
        dress(model.meshes[0])
    model.armature.data.pose_position = "POSE"
    model.carrier.scale = (figure.height / (highest.z - lowest.z),) * 3
    model.play(figure.action, figure.pace)
    times = keyed_times(frames)
    floor = 0.0  # of the action: no frame of it reaches below the ground
    for time in times:
        bpy.context.scene.frame_set(time)
        floor = min(floor, world_bounds(model.meshes)[0].z)

    clip_times = np.array(times) / max(frames - 1, 1)
    places, turns = body_poses(figure.way, np.zeros((1, 3)), clip_times, frames / FPS)
    start = Quaternion((0.0, 0.0, 1.0), math.radians(figure.heading))
    model.carrier.rotation_mode = "QUATERNION"
    key_linear(
        model.carrier, "location", {t: Vector(p) - Vector((0, 0, floor)) for t, p in zip(times, places, strict=True)}
    )
    key_linear(
        model.carrier, "rotation_quaternion", {t: Quaternion(q) @ start for t, q in zip(times, turns, strict=True)}
    )
    return BuiltFigure(figure.model, index, figure.height, model.armature)


def import_model(path: Path, index: int, frames: int, left_out: tuple[str, ...] = ()) -> Model:
    """Import an animated figure without meshes whose names begin with one of `left_out`; everything hangs on an empty."""
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    before, actions = set(bpy.data.objects), set(bpy.data.actions)
    bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 0, frames - 1  # the importer sets its own range
    scene.render.fps = FPS
    figure = [o for o in bpy.data.objects if o not in before]
    armature = next(o for o in figure if o.type == "ARMATURE")
    # the importer leaves helpers (bone shapes) and spare props; only what is skinned or worn is the figure
    for item in [o for o in figure if o.type == "MESH"]:
        if item.parent is None or not item.visible_get() or item.name.startswith(left_out):
            figure.remove(item)
            bpy.data.objects.remove(item)
    meshes = [o for o in figure if o.type == "MESH"]
    for material in {s.material for o in meshes for s in o.material_slots if s.material}:
        principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        nodes = Nodes(material.node_tree)
        linked = principled.inputs["Base Color"].links
        plain = nodes.add("RGB")
        plain.outputs[0].default_value = principled.inputs["Base Color"].default_value
        shade(nodes, linked[0].from_socket if linked else plain.outputs[0])
    for item in figure:
        item.pass_index = index
    carrier = bpy.data.objects.new("carrier", None)
    scene.collection.objects.link(carrier)
    for root in [o for o in figure if o.parent is None]:
        root.parent = carrier
    return Model(carrier, armature, meshes, [action for action in bpy.data.actions if action not in actions])


def dress(item: bpy.types.Object) -> None:
    """Give Cesium man skin, hair and clothes in place of a logo on white, in which the networks seldom see a person."""
    place = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    x, y, z = np.abs(place[:, 0]), place[:, 1], place[:, 2]
    skin, hair, shirt, trousers, shoes = (linear_color(one) for one in CLOTHES)
    color = np.tile(skin, (len(place), 1))
    color[(z < 1.13) & (x < 0.3)] = shirt
    color[(z < 0.66) & (x < 0.3)] = trousers
    color[z < 0.08] = shoes
    color[(z > 1.43) | ((z > 1.2) & (y > 0.0))] = hair
    item.data.attributes.new("clothes", "FLOAT_COLOR", "POINT").data.foreach_set(
        "color", color.astype(np.float32).ravel()
    )
    for slot in item.material_slots:
        nodes = Nodes(slot.material.node_tree)
        shade(nodes, nodes.add("Attribute", attribute_name="clothes").outputs["Color"])


def world_bounds(meshes) -> tuple[Vector, Vector]:
    """Lowest and highest corner of the evaluated meshes, world frame."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    corners = []
    for item in meshes:
        evaluated = item.evaluated_get(depsgraph)
        corners += [evaluated.matrix_world @ v.co for v in evaluated.data.vertices]
    points = np.array(corners)
    return Vector(points.min(0)), Vector(points.max(0))
