"""Shows edits and scores in the viewport and the sidebar: after an operator, at every frame, for a preview, in a render.

For scenes with edits that change over time (`f4x_timed` on the root) a handler draws every frame; all other scenes play as fast
as without edits.

A preview is no step of undo, so it must neither add nor remove datablocks: the cloud and the modifiers come with the import
(`make_ready`), empty and switched off.
"""

from __future__ import annotations

import contextlib

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.errors import F4xError
from ...f4x_core.troubles import EXPECTED, sentence_of
from ..common.gaussian_attributes import write_appearance, write_places
from ..common.point_cloud import RESIZES
from ..common.process_exit import end_process
from ..common.render_settings import ENGINE
from ..common.undo import end_step, leave_mode
from ..common.wording import error_line
from ..rig.motion_edits import refresh_keys
from ..scene import clip_time
from ..scene.scene_object import HANDLE_OF, HIDDEN, PREVIEW, TIMED, SceneObject, forget, keep_back_previews
from .drawing import (
    DRAWN,
    DRAWN_AT,
    VISIBLE,
    add_separate_cloud,
    add_visibility_modifier,
    draw,
    fit_separate_cloud,
    hash_of_stack,
    take_out_hidden,
)
from .listing import forget_counts, update_panel

_rendering = False
_failures: dict[int, Exception] = {}  # session_uid of a root -> why this frame of it could not be worked out


def refresh(scene_object: SceneObject, *, summary: bool = True) -> bool:
    """Show the preview of a scene, or its pending edits, at the current frame, and update the panel. May raise F4xError.

    `summary`: that of what the edits uncover, too, which takes longer than all the rest.
    Return True where datablocks came or went, of which undo must know: in a .blend of an older version, and before Blender 5.1.
    """
    leave_mode()
    display = scene_object.shown
    refresh_keys(scene_object)
    changed = fit_separate_cloud(scene_object, display)
    draw(scene_object, display, everything=True)
    _remove_handles(scene_object)
    scene_object.root[DRAWN] = hash_of_stack(scene_object)
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
        item = add_separate_cloud(scene_object, base, none)
        quats, sh, opacities = (values[none] for values in (base.static.quats, base.static.sh, base.static.opacities))
        write_places(item.data, base.static.means[none], quats, base.static.scales[none])
        write_appearance(item.data, quats, sh, opacities)
        for cloud in (*scene_object.clouds, item):
            if VISIBLE not in cloud.modifiers and "gid" in cloud.data.attributes:
                add_visibility_modifier(cloud)


def _remove_handles(scene_object: SceneObject) -> None:
    """Remove the handles of edits that are gone."""
    ids = {edit.id for edit in scene_object.stack.edits}
    for item in [item for item in scene_object.root.children if item.get(HANDLE_OF, 0) not in {0, *ids}]:
        bpy.data.objects.remove(item)


def is_drawn(scene_object: SceneObject) -> bool:
    """Return True if lists and points show the preview of a scene, or its pending edits."""
    holders = [scene_object.root, *(cloud.data for cloud in scene_object.clouds)]
    return {holder.get(DRAWN) for holder in holders} == {hash_of_stack(scene_object)}


def redraw(scene_object: SceneObject) -> None:
    """Like `refresh`, where no datablock may come or go: in the handlers of undo. Does nothing without the scene file."""
    with contextlib.suppress(F4xError):
        draw(scene_object, scene_object.shown, everything=True)


def hide(scene_object: SceneObject, hidden: np.ndarray) -> None:
    """Hide the Gaussians `hidden (N,) bool` and show all others, without an edit."""
    scene_object.write(**{HIDDEN: ("BOOLEAN", hidden)})
    take_out_hidden(scene_object.clouds)


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
    forget_counts(scene_object)
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
        draw(scene_object, scene_object.shown, everything=False, time=time)
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
def _evaluated(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Update scenes whose edits change over time, where Time was changed at the same frame."""
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
            scene_object.root[DRAWN] = hash_of_stack(scene_object)


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


HANDLERS = {
    "frame_change_post": _frame_changed,
    "depsgraph_update_post": _evaluated,
    "load_post": _file_loaded,
    "render_init": _render_began,
    "render_complete": _render_ended,
    "render_cancel": _render_ended,
    "save_pre": _will_save,
    "save_post": _saved,
    "save_post_fail": _saved,
}
