"""Handles of edits that move things: an empty for Blender's own tools and gizmos, whose transform is the edit's.

    NAME edit 3    child of the root; `f4x_edit` is the id of a `transform`: its location, rotation and scale are the edit's
                   `translate`, `rotate` and `scale` along Blender's axes, which are those of its parent inverse; its delta
                   location puts it on the thing

Whoever moves, turns or scales the empty, by G, R, S, a gizmo or a number, changes the same edit again and again, with Blender's
own Undo. Where the edit is changed elsewhere, the empty follows. It is never drawn in renders, and goes with its edit.
"""

from __future__ import annotations

import contextlib
import json
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import IntProperty
from mathutils import Quaternion, Vector

from ...f4x_core.edit.change import progress
from ...f4x_core.edit.operations import MAX_SCALE, Transform
from ...f4x_core.errors import F4xError
from ..common.axes import SceneAxes
from ..common.point_cloud import select_only
from ..edits import display, fields
from ..edits.fields import DIGITS
from ..scene.scene_object import HANDLE_OF, SceneObject
from .base import SceneOperator

SYNCED, SYNCED_EDIT = "f4x_synced", "f4x_synced_edit"
"""Properties of a handle: JSON of its values and of its edit's when they agreed."""
SIZE = 1.0
"""Half the drawn width of a handle, in standard deviations of the thing along its widest axis."""


def add_handle(scene_object: SceneObject, id: int) -> bpy.types.Object:
    """Return the handle of the `transform` with this id; a new one where there is none. F4xError for an edit of another kind."""
    found = handles_of(scene_object).get(id)
    if found is not None:
        return found
    operation = _operation(scene_object, id)
    if operation is None:
        raise F4xError(f"Edit {id} moves nothing; pick an edit that moves, rotates or scales something.")
    item = bpy.data.objects.new(f"{scene_object.name} edit {id}", None)
    scene_object.root.users_collection[0].objects.link(item)
    item.parent, item[HANDLE_OF], item.rotation_mode = scene_object.root, id, "QUATERNION"
    item.empty_display_type = "CUBE"
    _stand(scene_object, item, operation)
    return item


def handles_of(scene_object: SceneObject) -> dict[int, bpy.types.Object]:
    """Return the handles of a scene by the ids of their edits, without copies of them."""
    found = sorted(
        (item for item in scene_object.root.children if HANDLE_OF in item), key=lambda item: -item.session_uid
    )
    return {item[HANDLE_OF]: item for item in found}  # a copy is younger than its original


def follow(scene_object: SceneObject) -> None:
    """Let edits follow their handles where those were moved, and handles their edits where those were changed."""
    for id, item in handles_of(scene_object).items():
        operation = _operation(scene_object, id)
        if operation is None or (item.animation_data is not None and item.animation_data.action is not None):
            continue  # keys would change the edit at every frame
        if json.dumps(_values(item)) != item.get(SYNCED):
            item[SYNCED] = item[SYNCED_EDIT] = json.dumps(_values(item))
            fields.change(scene_object, id, later=True, **_values(item))
        elif (
            item.matrix_parent_inverse != scene_object.root.matrix_world.inverted_safe()
        ):  # the scene was placed elsewhere
            _stand(scene_object, item, operation)
        elif json.dumps(_fields(operation)) != item.get(SYNCED_EDIT):
            _put(item, operation)


def _stand(scene_object: SceneObject, item: bpy.types.Object, operation: Transform) -> None:
    """Give a handle Blender's axes where the scene is now, the transform of its edit, and a place and size by the thing."""
    item.matrix_parent_inverse = scene_object.root.matrix_world.inverted_safe()
    means = scene_object.shown.means_of(item[HANDLE_OF], scene_object.frame)
    size = (float(means.std(0).max()) if len(means) else 0.0) * scene_object.root.matrix_world.median_scale
    item.empty_display_size = SIZE * size
    _put(item, operation)
    put_on_thing(scene_object, item)


def put_on_thing(scene_object: SceneObject, item: bpy.types.Object) -> None:
    """Put a handle where the thing is at the current frame."""
    operation, means = (
        _operation(scene_object, item[HANDLE_OF]),
        scene_object.shown.means_of(item[HANDLE_OF], scene_object.frame),
    )
    if operation is not None and len(means):
        done = progress(
            operation.frames, operation.ease, scene_object.frame, float(scene_object.base.cameras.times[-1])
        )
        place = item.matrix_parent_inverse.inverted_safe() @ Vector(np.median(means, 0).tolist())
        item.delta_location = place - done * Vector(_axes(item).way_in_world(operation.translate))


def _operation(scene_object: SceneObject, id: int) -> Transform | None:
    """Return the `transform` with this id; None where there is none."""
    found = next((edit.operation for edit in fields.stack_of(scene_object).edits if edit.id == id), None)
    return found if isinstance(found, Transform) else None


def _axes(item: bpy.types.Object) -> SceneAxes:
    """Return the axes of a handle's numbers: Blender's where the scene was when they were written."""
    return SceneAxes.from_matrix(np.array(item.matrix_parent_inverse.inverted_safe()))


def _values(item: bpy.types.Object) -> dict[str, Any]:
    """Return the fields of the edit that a handle stands for."""
    axes = _axes(item)
    turn = np.rad2deg(item.rotation_quaternion.normalized().to_exponential_map())
    size = float(np.exp(np.mean(np.log(np.maximum(np.abs(item.scale), 1e-9)))))
    size = min(max(size, 1 / MAX_SCALE), MAX_SCALE)
    return {
        "translate": _rounded(axes.way_in_scene(item.location)),
        "rotate": _rounded(axes.turn_in_scene(turn)),
        "scale": round(size, DIGITS),
    }


def _fields(operation: Transform) -> dict[str, Any]:
    return {
        "translate": _rounded(operation.translate),
        "rotate": _rounded(operation.rotate),
        "scale": round(operation.scale, DIGITS),
    }


def _put(item: bpy.types.Object, operation: Transform) -> None:
    """Give a handle the transform of its edit."""
    axes = _axes(item)
    item.location = axes.way_in_world(operation.translate)
    item.rotation_quaternion = Quaternion(Vector(np.deg2rad(axes.turn_in_world(operation.rotate)).tolist()))
    item.scale = [operation.scale] * 3
    item[SYNCED], item[SYNCED_EDIT] = json.dumps(_values(item)), json.dumps(_fields(operation))


def _rounded(vector) -> tuple[float, float, float]:
    x, y, z = (round(float(part), DIGITS) + 0.0 for part in vector)
    return x, y, z


class F4X_OT_edit_gizmo(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Move, rotate and scale by Blender's own tools: the selection, as a new edit, or again what an edit moves."""

    bl_idname, bl_label = "f4x.edit_gizmo", "Transform by Gizmo"

    edit_id: IntProperty(
        name="Edit", description="Edit to change; 0: a new one, of the selection", min=0, options={"SKIP_SAVE"}
    )  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Make the edit and its handle active, with the tool that shows all gizmos."""
        handle = add_handle(scene_object, self.edit_id or _edit_of_selection(scene_object))
        handle.hide_set(False)
        select_only(handle)
        if context.area is not None and context.area.type == "VIEW_3D":
            bpy.ops.wm.tool_set_by_id(name="builtin.transform")


def _edit_of_selection(scene_object: SceneObject) -> int:
    """Return the id of the last edit, if it moves what is selected, else of a new one."""
    chosen, edits = scene_object.selected_ids, scene_object.stack.edits
    last = edits[-1] if edits else None
    if last and last.enabled and isinstance(last.operation, Transform) and last.operation.select == chosen:
        return last.id
    stack = scene_object.append(Transform(chosen))
    display.refresh(scene_object)
    return stack.edits[-1].id


CLASSES = (F4X_OT_edit_gizmo,)


@persistent
def _changed(scene: bpy.types.Scene, *_) -> None:
    roots = {item.parent for item in scene.objects if HANDLE_OF in item and item.parent is not None}
    for scene_object in SceneObject.among(roots):
        if not scene_object.is_linked:
            follow(scene_object)


@persistent
def _frame_changed(scene: bpy.types.Scene, *_) -> None:
    """Put the active handle on its thing, which may have moved; without the scene file it stays where it is."""
    item = bpy.context.view_layer.objects.active
    if item is None or HANDLE_OF not in item or bpy.app.is_job_running("RENDER"):
        return
    for scene_object in SceneObject.among([item.parent] if item.parent else []):  # an artist may hang it elsewhere
        with contextlib.suppress(F4xError):
            put_on_thing(scene_object, item)


HANDLERS = {"depsgraph_update_post": _changed, "frame_change_post": _frame_changed}
