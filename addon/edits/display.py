"""Shows edits and scores: appearance becomes point attributes, and edited motion becomes a separate point cloud.

Geometry nodes keep posing the base clouds. The modifier `Feature4X visible` deletes hidden and removed points, and those in the
separate cloud, from the evaluated base clouds. It deletes points with one of the attributes

    f4x_hidden   BOOLEAN  hidden by a person, in the viewport and in renders
    f4x_gone     BOOLEAN  removed by an edit, or part of the separate cloud

so all engines agree. The object `NAME edited` is the separate cloud, with positions and appearance that the core computes. For
scenes with edits that change over time (`f4x_timed` on the root) a handler writes them at every frame; all other scenes play
as fast as without edits.

A preview is no step of undo, so it must neither add nor remove datablocks: the cloud and the modifiers come with the import
(`make_ready`), empty and switched off.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from dataclasses import dataclass
from functools import cached_property

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.edit.apply import Appearance
from ...f4x_core.edit.description import describe_in
from ...f4x_core.edit.display import Display, by_score
from ...f4x_core.edit.operations import Operation
from ...f4x_core.edit.uncovered import summary_of, uncovered
from ...f4x_core.errors import F4xError
from ...f4x_core.language.colour_names import everyday_name, from_hex
from ...f4x_core.scene import PosedSplats, Scene
from ...f4x_core.scene.linear import Look, fitted_look
from ...f4x_core.troubles import EXPECTED, sentence_of
from ..common.axes import SceneAxes
from ..common.gaussian_attributes import RECOLORED, write_appearance, write_linear, write_places
from ..common.point_cloud import RESIZES, new_point_cloud, read_attribute, write_attribute
from ..common.process_exit import end_process
from ..common.render_settings import ENGINE
from ..common.undo import end_step, leave_mode
from ..common.wording import error_line, panel_words
from ..rig.motion_edits import refresh_keys
from ..scene import clip_time
from ..scene.scene_object import (
    APART,
    EDITS,
    HANDLE_OF,
    HIDDEN,
    PREVIEW,
    SCORE,
    SELECTED,
    TIMED,
    SceneObject,
    forget,
    keep_back_previews,
)
from ..scene.tints import add_tints, are_shown, tints_of, write_gain, write_tints

GONE, LOOKS = "f4x_gone", "f4x_looks"
DRAWN = "f4x_drawn"
"""Property of a root and of point clouds: hash of the stack that its lists and their points show.

Each has its own: undo brings back a root and not points that are the same in both steps, though they were drawn otherwise
since; and it draws points and leaves the lists.
"""
VISIBLE = "Feature4X visible"
"""Name of the modifier and of its tree."""
HEX = re.compile(r"#([0-9a-f]{6})\b")
"""A color in a row of the list of edits that has no name of its own."""
DRAWN_AT = "f4x_drawn_at"
"""Property of a root: Time at which its points were drawn last."""
WORLD_AXES = "Blender's X, Y and Z"
"""Axes of the ways and turns in the list of edits."""
_rendering = False
_failures: dict[int, Exception] = {}  # session_uid of a root -> why this frame of it could not be worked out
_counts: dict[int, tuple[int, int]] = {}  # session_uid of a root -> what `counts` found since anything changed


def refresh(scene_object: SceneObject, *, summary: bool = True) -> bool:
    """Show the preview of a scene, or its pending edits, at the current frame, and update the panel. May raise F4xError.

    `summary`: that of what the edits uncover, too, which takes longer than all the rest.
    Return True where datablocks came or went, of which undo must know: in a .blend of an older version, and before Blender 5.1.
    """
    leave_mode()
    display = scene_object.shown
    refresh_keys(scene_object)
    changed = _fit_separate_cloud(scene_object, display)
    _draw(scene_object, display, everything=True)
    _remove_handles(scene_object)
    scene_object.root[DRAWN] = _hash(scene_object)
    scene_object.root[TIMED] = display.changes
    if display.changes or PREVIEW in scene_object.root:  # handlers write attributes while a render reads them
        bpy.context.scene.render.use_lock_interface = True
    update_panel(scene_object, summary)
    return changed


def preview(scene_object: SceneObject, on: bool) -> None:
    """Show the picked reading of the sentence in place of the pending edits, or these again. May raise F4xError."""
    scene_object.show_preview(scene_object.with_reading() if on else None)
    left = leave_mode()
    if refresh(scene_object) or left:
        end_step("Preview")


def make_ready(scene_object: SceneObject) -> None:
    """Add what edits need, empty and switched off, where Blender can fill it later: no preview then adds or removes datablocks."""
    if RESIZES:
        base, none = scene_object.base, np.zeros(0, int)
        item = _add_separate_cloud(scene_object, base, none)
        quats, sh, opacities = (values[none] for values in (base.static.quats, base.static.sh, base.static.opacities))
        write_places(item.data, base.static.means[none], quats, base.static.scales[none])
        write_appearance(item.data, quats, sh, opacities)
        for cloud in (*scene_object.clouds, item):
            if VISIBLE not in cloud.modifiers and "gid" in cloud.data.attributes:
                _add_visibility_modifier(cloud)


def _remove_handles(scene_object: SceneObject) -> None:
    """Remove the handles of edits that are gone."""
    ids = {edit.id for edit in scene_object.stack.edits}
    for item in [item for item in scene_object.root.children if item.get(HANDLE_OF, 0) not in {0, *ids}]:
        bpy.data.objects.remove(item)


def is_drawn(scene_object: SceneObject) -> bool:
    """Return True if lists and points show the preview of a scene, or its pending edits."""
    holders = [scene_object.root, *(cloud.data for cloud in scene_object.clouds)]
    return {holder.get(DRAWN) for holder in holders} == {_hash(scene_object)}


def _hash(scene_object: SceneObject) -> str:
    text = scene_object.shown_edits if EDITS in scene_object.root else ""
    return hashlib.sha256(text.encode()).hexdigest()


def redraw(scene_object: SceneObject) -> None:
    """Like `refresh`, where no datablock may come or go: in the handlers of undo. Does nothing without the scene file."""
    with contextlib.suppress(F4xError):
        _draw(scene_object, scene_object.shown, everything=True)


def update_panel(scene_object: SceneObject, summary: bool = True) -> None:
    """Update the lists and counts of the sidebar from the pending edits, and the `summary` of what they uncover."""
    # a script may import without registering the extension; lists of a linked scene cannot be changed
    if hasattr(scene_object.root, "f4x") and not scene_object.is_linked:
        _fill_lists(scene_object)
        count(scene_object)
        if summary:
            scene_object.state.uncovered = panel_words(summary_of(uncovered(scene_object.edited)))


def hide(scene_object: SceneObject, hidden: np.ndarray) -> None:
    """Hide the Gaussians `hidden (N,) bool` and show all others, without an edit."""
    scene_object.write(**{HIDDEN: ("BOOLEAN", hidden)})
    _take_out_hidden(scene_object.clouds)


def count(scene_object: SceneObject) -> None:
    """Remember the numbers of selected and existing Gaussians after an operator selected."""
    scene_object.state.selected, scene_object.state.total = counts(scene_object)


def counts(scene_object: SceneObject) -> tuple[int, int]:
    """Return the numbers of selected and existing Gaussians, whoever selected or deleted points since; a preview removes none."""
    if PREVIEW in scene_object.root:
        with contextlib.suppress(F4xError):  # the file is gone: the points as they are drawn are all that is known
            return _counts_without_preview(scene_object)
    selected = total = 0
    for cloud in scene_object.clouds:
        chosen, gone = (read_attribute(cloud.data, name) for name in (SELECTED, GONE))
        there = np.ones(len(cloud.data.points), bool) if gone is None else ~gone
        total += int(there.sum())
        selected += 0 if chosen is None else int((chosen & there).sum())
    return selected, total


def _counts_without_preview(scene_object: SceneObject) -> tuple[int, int]:
    pending = scene_object.pending
    there = pending.appearance(scene_object.frame).opacities > 0
    chosen = np.isin(pending.scene.ids, scene_object.shown.scene.ids[scene_object.read(SELECTED)])
    return int((chosen & there).sum()), int(there.sum())


def last_counts(scene_object: SceneObject) -> tuple[int, int]:
    """Return `counts`, worked out only where Blender has seen a change since the last call: panels are drawn often."""
    uid = scene_object.root.session_uid
    if uid not in _counts:
        _counts[uid] = counts(scene_object)
    return _counts[uid]


def words_of(operation: Operation, axes: SceneAxes) -> str:
    """Return an edit in the words of its row: numbers of its dialog, along Blender's axes where the scene is, and named colors."""
    words = describe_in(operation, axes.to_world, WORLD_AXES)
    return HEX.sub(lambda found: f"{everyday_name(from_hex(found[1]))} ({found[0]})", words)


def _fill_lists(scene_object: SceneObject) -> None:
    """Update the lists of edits and of named selections from the pending edits."""
    state = scene_object.state
    before, picked = len(state.history), state.history_index
    state.history.clear()
    for edit in scene_object.stack.edits:
        row = state.history.add()
        row.edit_id, row.enabled = edit.id, edit.enabled
    state.history_index = picked if before == len(state.history) else len(state.history) - 1
    state.names.clear()
    for name, rows in scene_object.names.items():
        row = state.names.add()
        row.name, row.count = name, len(rows)
    state.name_index = min(max(state.name_index, 0), len(state.names) - 1)


def _fit_separate_cloud(scene_object: SceneObject, display: Display) -> bool:
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
        _add_separate_cloud(scene_object, display.scene, display.apart)
    scene_object.write(**kept)
    return True


def _add_separate_cloud(scene_object: SceneObject, scene: Scene, apart: np.ndarray) -> bpy.types.Object:
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


def _draw(scene_object: SceneObject, display: Display, everything: bool, time: float | None = None) -> None:
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
    stack = _hash(scene_object)
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
    _take_out_hidden(scene_object.clouds)


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


def _differing(sh: np.ndarray, of_file: np.ndarray) -> np.ndarray:
    """Return (N,) bool, True where `sh (N,S,3)` differs from the file's `of_file (M,S,3)`, and for copies, which come last."""
    differs = np.ones(len(sh), bool)
    if sh is of_file:
        differs[:] = False
    elif sh.shape[1:] == of_file.shape[1:]:
        differs[: len(of_file)] = (sh[: len(of_file)] != of_file).any((1, 2))
    return differs


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


def _take_out_hidden(clouds: list[bpy.types.Object]) -> None:
    """Switch the modifier on in clouds with points that must not be shown, and off elsewhere: it takes time at every frame."""
    for cloud in clouds:
        out = [read_attribute(cloud.data, name) for name in (HIDDEN, GONE)]
        needed = any(values is not None and values.any() for values in out)
        modifier = cloud.modifiers.get(VISIBLE)
        # a preview's separate cloud is hidden while something renders, when modifiers cannot come any more
        if modifier is None and (needed or APART in cloud):
            modifier = _add_visibility_modifier(cloud)
        if modifier is not None and modifier.show_render != needed:
            modifier.show_viewport = modifier.show_render = needed


def _add_visibility_modifier(cloud: bpy.types.Object) -> bpy.types.Modifier:
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


def check_frame(scene: bpy.types.Scene) -> None:
    """Raise F4xError if a scene in `scene` still shows another frame because this one of it could not be worked out."""
    for root in scene.objects:
        if root.session_uid in _failures and root.get(TIMED):
            failure = _failures[root.session_uid]
            raise F4xError(sentence_of(failure)) from failure


@persistent
def _frame_changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Update scenes whose edits change over time."""
    for root in [item for item in scene.objects if item.get(TIMED)]:
        _draw_timed(SceneObject(root), clip_time.time_of(root, depsgraph))
    _end_wrong_render(scene)


def _draw_timed(scene_object: SceneObject, time: float) -> None:
    """Draw a clip frame of a scene whose edits change over time; where that fails, renders of it are refused."""
    uid = scene_object.root.session_uid
    _counts.pop(uid, None)
    before = _failures.pop(uid, None)
    try:
        _draw_frame(scene_object, time)
    except EXPECTED as error:  # playback goes on with what was drawn last; renders do not
        _failures[uid] = error
        if before is None or before.args != error.args:
            print(f"Feature4X: {error_line(error)}")


def _draw_frame(scene_object: SceneObject, time: float) -> None:
    """Draw a clip frame of a scene whose edits change over time. Raises F4xError where that is impossible."""
    if scene_object.is_linked:  # Blender drops what is written to points of another file
        raise F4xError(f"The edits of {scene_object.name} change over time, and {scene_object.why_linked_stays}.")
    try:
        _draw(scene_object, scene_object.shown, everything=False, time=time)
    except F4xError as error:
        raise F4xError(
            f"{error} The edits of {scene_object.name} change over time, so no frame can be rendered without its scene file;"
            " Object > Feature4X > Pack Scene keeps it in the .blend."
        ) from error


def _end_wrong_render(scene: bpy.types.Scene) -> None:
    """End a Blender without a window in which an engine of another kind, which asks nobody, is about to draw a wrong frame."""
    if _rendering and bpy.app.background and scene.render.engine != ENGINE:
        try:
            check_frame(scene)
        except F4xError as error:
            print(f"Error: {error_line(error)}", flush=True)
            end_process(1)


@persistent
def _changed(*_) -> None:
    _counts.clear()


@persistent
def _evaluated(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Update scenes whose edits change over time, where Time was changed at the same frame."""
    _counts.clear()
    for root in [item for item in scene.objects if item.get(TIMED)]:
        time = clip_time.time_of(root)
        if root.get(DRAWN_AT, time) != time and root.session_uid not in _failures:
            _draw_timed(SceneObject(root), time)


def _show_previews(why: str, on: bool) -> None:
    """Draw scenes that have a preview without it, or with it again; `why` they are without."""
    keep_back_previews(why, not on)
    for scene_object in SceneObject.among(bpy.data.objects):
        if PREVIEW in scene_object.root and not scene_object.is_linked:
            redraw(scene_object)
            scene_object.root[DRAWN] = _hash(scene_object)


@persistent
def _render_began(scene: bpy.types.Scene, *_) -> None:
    global _rendering
    _rendering = True
    _show_previews("render", False)


@persistent
def _render_ended(scene: bpy.types.Scene, *_) -> None:
    global _rendering
    _rendering = False
    _show_previews("render", True)


@persistent
def _will_save(*_) -> None:
    _show_previews("save", False)


@persistent
def _saved(*_) -> None:
    _show_previews("save", True)


@persistent
def _file_loaded(path: str) -> None:
    forget()
    _failures.clear()
    _counts.clear()


HANDLERS = {
    "frame_change_post": _frame_changed,
    "depsgraph_update_post": _evaluated,
    "undo_post": _changed,
    "redo_post": _changed,
    "load_post": _file_loaded,
    "render_init": _render_began,
    "render_complete": _render_ended,
    "render_cancel": _render_ended,
    "save_pre": _will_save,
    "save_post": _saved,
    "save_post_fail": _saved,
}
