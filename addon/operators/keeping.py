"""Operators on the pending edits as a whole: their list and the scene file; what saving a .blend and undo do to them."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ...f4x_core.edit.operations import Delete, Extract
from ...f4x_core.errors import F4xError
from ...f4x_core.language.lexicon import plural
from ...f4x_core.troubles import EXPECTED
from ..common.wording import error_line
from ..edits import display, fields
from ..jobs.preferences import preferences
from ..scene.scene_object import EDITS, PREVIEW, TIMED, SceneObject
from . import point_edits
from .base import DescribedChoice, SceneOperator
from .planning import forget_readings

_typed: dict[int, str] = {}  # session_uid of a root -> its sentence before the undo that is under way


class F4X_OT_restore(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Bring back everything that was removed, by switching off the edits that remove something."""

    bl_idname, bl_label = "f4x.restore", "Restore"

    def act(self, context, scene_object):
        """Switch off what removes."""
        stack = scene_object.stack
        removing = [edit for edit in stack.edits if edit.enabled and isinstance(edit.operation, Delete | Extract)]
        if not removing:
            raise F4xError("No active edit removes anything, so there is nothing to restore; see the panel Edits.")
        for edit in removing:
            stack = stack.enable(edit.id, False)
        scene_object.set_stack(stack)
        display.refresh(scene_object)


class F4X_OT_history(DescribedChoice, SceneOperator, bpy.types.Operator):  # noqa: N801
    """Change the list of edits."""

    bl_idname, bl_label = "f4x.history", "Edit History"

    how: EnumProperty(  # type: ignore[valid-type]
        name="How",
        items=(
            ("TOGGLE", "Toggle", "Switch this edit on or off"),
            ("REMOVE", "Delete", "Delete this edit"),
            ("UP", "Earlier", "Apply this edit before the one above it"),
            ("DOWN", "Later", "Apply this edit after the one below it"),
            ("CLEAR", "Clear", "Delete all edits"),
        ),
    )
    edit_id: IntProperty(name="Edit")  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Change the stack, and show it."""
        stack = scene_object.stack
        if self.how == "CLEAR":
            stack = type(stack)()
        else:
            at = stack.position(self.edit_id)
            if self.how == "TOGGLE":
                stack = stack.enable(self.edit_id, not stack.edits[at].enabled)
            elif self.how == "REMOVE":
                stack = stack.remove(self.edit_id)
            else:
                to = at - 1 if self.how == "UP" else at + 1
                stack = stack.move(self.edit_id, min(max(to, 0), len(stack) - 1))
        scene_object.set_stack(stack)
        display.refresh(scene_object)
        state = scene_object.state
        index = next((i for i, row in enumerate(state.history) if row.edit_id == self.edit_id), None)
        state.history_index = len(state.history) - 1 if index is None else index


class F4X_OT_save_edits(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Save the edits in the scene file, so that the f4x command and other Blender files use them too."""

    bl_idname, bl_label = "f4x.save_edits", "Save Edits to Scene"

    def act(self, context, scene_object):
        """Write atomically; edits that others wrote in the meantime are merged, undone ones are taken out."""
        stack = scene_object.save()
        display.refresh(scene_object)
        if touched := point_edits.summary(scene_object):
            self.report({"WARNING"}, f"{touched}; press Take Over Deleted and Moved Points, and save again")
        self.report({"INFO"}, f"Saved {len(stack)} {plural('edit', len(stack))} in {scene_object.path.name}")


class F4X_OT_save_as(SceneOperator, bpy.types.Operator, ExportHelper):  # noqa: N801
    """Write the scene with its edits into a new scene file and use that from now on. The file it came from stays as it is."""

    bl_idname, bl_label = "f4x.save_as", "Save As Scene"

    filename_ext = ".f4x"
    filter_glob: StringProperty(default="*.f4x", options={"HIDDEN"})  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Write the new file, complete or not at all."""
        scene_object.save_as(Path(bpy.path.abspath(self.filepath)))
        display.refresh(scene_object)
        self.report({"INFO"}, f"Saved {scene_object.path}")


@persistent
def _save_along(path: str) -> None:
    """Save the edits when the .blend is saved, if the preferences ask for it."""
    settings = preferences()
    for scene_object in [each for each in SceneObject.among(bpy.data.objects) if not each.is_linked]:
        try:
            if settings is not None and settings.save_edits and scene_object.holds_edits and not scene_object.is_saved:
                scene_object.save()
            scene_object.remember()
        except EXPECTED as error:  # the .blend keeps the edits, and is saved all the same
            scene_object.state.answer = error_line(error)


@persistent
def _opened(*_) -> None:
    """Forget plans of the session in which the .blend was saved: its points show the pending edits alone."""
    for scene_object in SceneObject.among(bpy.data.objects):
        if (PREVIEW in scene_object.root or scene_object.state.readings) and not scene_object.is_linked:
            forget_readings(scene_object)


@persistent
def _before_undo(*_) -> None:
    _typed.clear()
    _typed.update({each.root.session_uid: each.state.sentence for each in SceneObject.among(bpy.data.objects)})


@persistent
def _undone(*_) -> None:
    """Draw what undo or redo cannot bring back by itself.

    A plan is part of no step, so it ends; the sentence stays in its field. What changes over time is drawn anew, for undo brings
    points back as they were at another frame, and keeps the frame. So are edits that were not shown yet when Blender noted down
    its step, and points that a preview had changed since.
    """
    shown = bpy.context.scene.objects
    for scene_object in [each for each in SceneObject.among(bpy.data.objects) if not each.is_linked]:
        root = scene_object.root
        if PREVIEW in root or scene_object.state.readings:
            forget_readings(scene_object)
        scene_object.state.sentence = _typed.get(root.session_uid, scene_object.state.sentence)
        if root.get(TIMED) and root.name in shown:
            display.redraw(scene_object)
        if EDITS in root:
            scene_object.remember()
            if root.name in shown and not display.is_drawn(scene_object):
                fields.show_after_undo(scene_object)
    _typed.clear()


HANDLERS = {
    "load_post": _opened,
    "save_pre": _save_along,
    "undo_pre": _before_undo,
    "redo_pre": _before_undo,
    "undo_post": _undone,
    "redo_post": _undone,
}

CLASSES = (
    F4X_OT_restore,
    F4X_OT_history,
    F4X_OT_save_edits,
    F4X_OT_save_as,
)
