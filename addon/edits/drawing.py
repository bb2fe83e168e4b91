"""Draws a scene with its edits: appearance becomes point attributes, and edited motion a separate point cloud.

Geometry nodes keep posing the base clouds. The modifier `Feature4X visible` deletes hidden and removed points, and those in the
separate cloud, from the evaluated base clouds. It deletes points with one of the attributes

    f4x_hidden   BOOLEAN  hidden by a person, in the viewport and in renders
    f4x_gone     BOOLEAN  removed by an edit, or part of the separate cloud

so all engines agree. The object `NAME edited` is the separate cloud, with positions and appearance that the core computes.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import bpy
import numpy as np

from ...f4x_core.edit.apply import Appearance
from ...f4x_core.edit.display import Display, by_score
from ...f4x_core.scene import PosedSplats, Scene
from ...f4x_core.scene.linear import Look, fitted_look
from ..common.gaussian_attributes import RECOLORED, write_appearance, write_linear, write_places
from ..common.point_cloud import RESIZES, new_point_cloud, read_attribute, write_attribute
from ..scene import clip_time
from ..scene.scene_object import APART, EDITS, HIDDEN, SCORE, SceneObject
from ..scene.tints import add_tints, are_shown, tints_of, write_gain, write_tints

GONE, LOOKS = "f4x_gone", "f4x_looks"
DRAWN = "f4x_drawn"
"""Property of a root and of point clouds: hash of the stack that its lists and their points show.

Each has its own: undo brings back a root and not points that are the same in both steps, though they were drawn otherwise
since; and it draws points and leaves the lists.
"""
DRAWN_AT = "f4x_drawn_at"
"""Property of a root: Time at which its points were drawn last."""
VISIBLE = "Feature4X visible"
"""Name of the modifier and of its tree."""


def draw(scene_object: SceneObject, display: Display, everything: bool, time: float | None = None) -> None:
    """Write the point attributes of a clip frame, None = the current one; without `everything`, only those that changed."""
    time = clip_time.time_of(scene_object.root) if time is None else time
    scene_object.root[DRAWN_AT], frame = time, display.time(time)
    moment = _Moment.of(scene_object, display, frame)
    appearance, linear = moment.appearance, moment.linear
    key = repr(display.appearance_key(frame))
    everything = everything or scene_object.root.get(LOOKS) != key
    scene_object.root[LOOKS] = key
    elsewhere = appearance.opacities == 0
    elsewhere[display.apart] = True
    recolored = _differing(appearance.sh, scene_object.base.full_appearance[1])
    stack = hash_of_stack(scene_object)
    for cloud, at, row in scene_object.points():
        if APART in cloud:
            _draw_separate_cloud(cloud.data, (at, row), moment)
        elif everything and len(at) == len(cloud.data.points):  # else an artist joined it with something else
            write_attribute(cloud.data, GONE, "BOOLEAN", elsewhere[row])
            before = read_attribute(cloud.data, RECOLORED)
            rows = None if before is None else np.flatnonzero(before | recolored[row])
            origin = display.scene.origin[row]  # of a copy that an artist joined with its original
            quats = display.rest_rotation[
                origin
            ]  # geometry nodes turn what the attributes hold, and harmonics by as much
            write_appearance(cloud.data, quats, appearance.sh[row], appearance.opacities[row], rows)
            write_attribute(cloud.data, RECOLORED, "BOOLEAN", recolored[row])
            if linear is not None:
                linear.write(cloud.data, row, appearance, display)
            if display.scene.tints is not None:
                write_gain(cloud.data, moment.gain[row])
            cloud.data.update_tag()
        if everything:
            cloud.data[DRAWN] = stack
    take_out_hidden(scene_object.clouds)


@dataclass(frozen=True, eq=False)
class _Moment:
    """A scene at one clip frame, as its point clouds are to show it. N Gaussians in the order of `posed`."""

    display: Display
    frame: float
    appearance: Appearance
    """Without tints."""
    linear: _Linear | None
    """The appearance for linear light, where an engine wants it."""
    scored: bool
    """True for a heat map, whose colors stay."""
    tinted: bool
    """True where the separate cloud gets its colors over time with its places, at every frame, and not by geometry nodes."""

    @classmethod
    def of(cls, scene_object: SceneObject, display: Display, frame: float) -> _Moment:
        """Return the scene with the edits of `display`."""
        appearance = display.appearance(frame)
        scored = hasattr(scene_object.root, "f4x") and scene_object.state.show_score
        if scored:
            appearance = by_score(appearance, scene_object.read(SCORE))
        tinted = display.changes and not scored and are_shown(scene_object.clouds)
        return cls(display, frame, appearance, _Linear.of(scene_object, frame), scored, tinted)

    @cached_property
    def gain(self) -> np.ndarray:
        """(N,3) by how much geometry nodes multiply tints."""
        return np.zeros((len(self.appearance.sh), 3)) if self.scored else self.display.tint_gain(self.appearance)

    @cached_property
    def apart(self) -> PosedSplats:
        """The Gaussians of the separate cloud."""
        return self.display.moment(self.frame)


@dataclass(frozen=True)
class _Linear:
    """The appearance of a scene that engines for linear light draw in place of the fitted one."""

    display: Display
    appearance: Appearance

    @classmethod
    def of(cls, scene_object: SceneObject, frame: float) -> _Linear | None:
        """Return the appearance at a clip frame; None where no engine needs it."""
        display = scene_object.shown_linear
        if display is None:
            return None
        appearance = display.appearance(frame)
        if hasattr(scene_object.root, "f4x") and scene_object.state.show_score:
            appearance = by_score(appearance, scene_object.read(SCORE))
        return cls(display, appearance)

    def write(self, data: bpy.types.PointCloud, row: np.ndarray, fitted: Appearance, shown: Display) -> None:
        """Write both appearances of the points that are rows `row` of the base scene."""
        pairs = (shown, fitted), (self.display, self.appearance)
        looks = (
            Look(fitted_look(display.scene).scales[row], part.opacities[row], part.sh[row, 0])
            for display, part in pairs
        )
        write_linear(data, *looks)


def show_linear(scene_object: SceneObject) -> None:
    """Let Blender's own engines draw the unedited scene as they should, where they draw splats."""
    linear = _Linear.of(scene_object, scene_object.frame)
    if linear is not None:
        shown = scene_object.shown
        for cloud, _, row in scene_object.points():
            linear.write(cloud.data, row, shown.appearance(scene_object.frame), shown)


def _draw_separate_cloud(data: bpy.types.PointCloud, points: tuple[np.ndarray, np.ndarray], shown: _Moment) -> None:
    """Write what the separate cloud shows; `points`: (at, row) as of `SceneObject.points`.

    Points that are not drawn apart, which an undone plan leaves, are shown by no picture.
    """
    display, linear = shown.display, shown.linear
    at, row = points
    inside = np.isin(row, display.apart)
    at, row = at[inside], row[inside]
    out = np.ones(len(data.points), bool)
    out[at] = shown.appearance.opacities[row] == 0
    write_attribute(data, GONE, "BOOLEAN", out)
    if len(at):
        moment, part = shown.apart, np.searchsorted(display.apart, row)

        def spread(values: np.ndarray) -> np.ndarray:
            every = np.zeros((len(out), *values.shape[1:]), np.float32)
            every[at] = values
            return every

        def colors(posed: PosedSplats, appearance: Appearance) -> np.ndarray:
            return spread(posed.sh[part] if shown.tinted else appearance.sh[row])

        quats, sh = spread(moment.quats[part]), colors(moment, shown.appearance)
        write_places(data, spread(moment.means[part]), quats, spread(moment.scales[part]))
        write_appearance(data, quats, sh, spread(moment.opacities[part]))
        if display.scene.tints is not None:
            write_gain(data, np.zeros((len(out), 3)) if display.changes else spread(shown.gain[row]))
        if linear is not None:
            other = linear.display.moment(shown.frame)
            looks = (
                Look(spread(each.scales[part]), spread(each.opacities[part]), dc)
                for each, dc in ((moment, sh[:, 0]), (other, colors(other, linear.appearance)[:, 0]))
            )
            write_linear(data, *looks)
    data.update_tag()


def _differing(sh: np.ndarray, of_file: np.ndarray) -> np.ndarray:
    """Return (N,) bool, True where `sh (N,S,3)` differs from the file's `of_file (M,S,3)`, and for copies, which come last."""
    differs = np.ones(len(sh), bool)
    if sh is of_file:
        differs[:] = False
    elif sh.shape[1:] == of_file.shape[1:]:
        differs[: len(of_file)] = (sh[: len(of_file)] != of_file).any((1, 2))
    return differs


def fit_separate_cloud(scene_object: SceneObject, display: Display) -> bool:
    """Let the separate cloud have the needed points; selection and scores are kept. Return True where datablocks came or went."""
    old = next((cloud for cloud in scene_object.clouds if APART in cloud), None)
    ids = display.scene.ids[display.apart].astype(np.int32)
    if np.array_equal([] if old is None else read_attribute(old.data, "gid"), ids):
        return False
    kept = scene_object.marks
    if old is not None and RESIZES:
        old.data.resize(len(ids))
        _identify(old.data, display.scene, display.apart)
        scene_object.write(**kept)
        return False
    if old is not None:
        data = old.data
        bpy.data.objects.remove(old)
        bpy.data.pointclouds.remove(data)
    if len(ids):
        add_separate_cloud(scene_object, display.scene, display.apart)
    scene_object.write(**kept)
    return True


def add_separate_cloud(scene_object: SceneObject, scene: Scene, apart: np.ndarray) -> bpy.types.Object:
    """Add the separate cloud of the Gaussians `apart (n,)`, rows of `scene`, without places and appearance."""
    model = scene_object.clouds[0]
    item = new_point_cloud(f"{scene_object.name} edited", len(apart), model.users_collection[0])
    item.parent = scene_object.root
    item[APART] = True
    for material in model.data.materials:
        item.data.materials.append(material)
    _identify(item.data, scene, apart)
    if scene.tints is not None:
        add_tints(scene_object.root, item, scene.tints.times, are_shown(scene_object.clouds))
    return item


def _identify(data: bpy.types.PointCloud, scene: Scene, apart: np.ndarray) -> None:
    """Write which Gaussians the points of the separate cloud are, and their tints."""
    write_attribute(data, "gid", "INT", scene.ids[apart])
    if scene.tints is not None:
        write_tints(data, tints_of(scene)[scene.origin[apart]])


def take_out_hidden(clouds: list[bpy.types.Object]) -> None:
    """Switch the modifier on in clouds with points that must not be shown, and off elsewhere: it takes time at every frame."""
    for cloud in clouds:
        out = [read_attribute(cloud.data, name) for name in (HIDDEN, GONE)]
        needed = any(values is not None and values.any() for values in out)
        modifier = cloud.modifiers.get(VISIBLE)
        # a preview's separate cloud is hidden while something renders, when modifiers cannot come any more
        if modifier is None and (needed or APART in cloud):
            modifier = add_visibility_modifier(cloud)
        if modifier is not None and modifier.show_render != needed:
            modifier.show_viewport = modifier.show_render = needed


def add_visibility_modifier(cloud: bpy.types.Object) -> bpy.types.Modifier:
    """Return the modifier that deletes points that must not be shown, added to a cloud and switched off."""
    modifier = cloud.modifiers.new(VISIBLE, "NODES")
    modifier.node_group = bpy.data.node_groups.get(VISIBLE) or _visible_tree()
    modifier.show_expanded = modifier.show_viewport = modifier.show_render = False
    return modifier


def _visible_tree() -> bpy.types.GeometryNodeTree:
    """Return a node tree that deletes hidden and removed points."""
    tree = bpy.data.node_groups.new(VISIBLE, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "FunctionNodeBooleanMath", "GeometryNodeDeleteGeometry", "NodeGroupOutput")
    source, either, delete, sink = (tree.nodes.new(kind) for kind in kinds)
    either.operation = "OR"
    for socket, name in zip(either.inputs, (HIDDEN, GONE), strict=False):
        attribute = tree.nodes.new("GeometryNodeInputNamedAttribute")
        attribute.data_type = "BOOLEAN"
        attribute.inputs["Name"].default_value = name
        attribute.location = (-400, -150 * len(name))
        tree.links.new(next(output for output in attribute.outputs if output.enabled), socket)
    tree.links.new(source.outputs[0], delete.inputs["Geometry"])
    tree.links.new(either.outputs[0], delete.inputs["Selection"])
    tree.links.new(delete.outputs[0], sink.inputs[0])
    for column, node in enumerate((source, either, delete, sink)):
        node.location = (200 * column - 200, 0)
    return tree


def hash_of_stack(scene_object: SceneObject) -> str:
    """Return the hash of the stack that is shown, for `DRAWN`."""
    text = scene_object.shown_edits if EDITS in scene_object.root else ""
    return hashlib.sha256(text.encode()).hexdigest()
