"""Changing what is selected: every operator appends operations of the core to the pending stack, and shows them."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    StringProperty,
)
from bpy_extras.io_utils import ExportHelper
from mathutils import Euler

from ...f4x_core.edit.change import holds
from ...f4x_core.edit.operations import (
    NOTHING_ALONG,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Name,
    Opacity,
    Operation,
    Recolour,
    Retime,
    Reverse,
    Span,
    Style,
    Transform,
)
from ...f4x_core.edit.plan_lines import plan_lines
from ...f4x_core.edit.selects import All
from ...f4x_core.edit.styles import STYLES
from ...f4x_core.errors import F4xError
from ...f4x_core.language.lexicon import PLACES, plural
from ...f4x_core.language.refusal import Doubt
from ...f4x_core.progress import Progress
from ...f4x_core.troubles import EXPECTED
from ..common.undo import end_step
from ..common.wording import error_line, panel_words
from ..edits import display, fields, marking
from ..jobs.preferences import preferences
from ..scene import cache, clip_time
from ..scene.scene_object import EDITS, PREVIEW, TIMED, SceneObject
from . import point_edits
from .base import DescribedChoice, SceneOperator
from .searching import SearchOperator

if TYPE_CHECKING:
    from ...f4x_core.edit.plan import Proposal
    from ...f4x_core.edit.selecting import SelectingSentence

_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []
READINGS = 4
"""Ways to carry out a sentence that are offered when the plain one is not it."""

_typed: dict[int, str] = {}  # session_uid of a root -> its sentence before the undo that is under way


def _span(scene_object: SceneObject) -> Span | None:
    """Return the time span of the selection."""
    state = scene_object.state
    return (float(state.first), float(state.last)) if state.use_span else None


class _Edit(SceneOperator):
    """An operator that appends one operation on the selection."""

    def operation(self, scene_object: SceneObject) -> Operation:
        """Return the operation to append."""
        raise NotImplementedError

    def planned(self, scene_object: SceneObject) -> Operation:
        """Return the operation to append, with all settings."""
        return self.operation(scene_object)

    def act(self, context, scene_object):
        """Append and show it."""
        scene_object.append(self.planned(scene_object))
        display.refresh(scene_object)
        self.report({"INFO"}, scene_object.state.history[-1].name)


class _EditWithShadow(_Edit):
    """An edit that the shadow of the selection takes part in unless it is told not to."""

    shadow: BoolProperty(  # type: ignore[valid-type]
        name="With Its Shadow",
        description="Also change the moving shadow, reflection and loose edges of the selection",
        default=True,
    )

    def planned(self, scene_object):
        """Leave what would go along as it is where that is asked for."""
        operation = self.operation(scene_object)
        return operation if self.shadow else replace(operation, along=NOTHING_ALONG)


class _Dialog(_Edit):
    """An edit with a dialog for its settings."""

    def invoke(self, context, event):
        """Open the dialog; times default to the current frame and the end of the clip."""
        scene_object = SceneObject.of(context.object)
        last = int(scene_object.base.cameras.times[-1])
        for name, value in (("first", round(scene_object.frame)), ("last", last)):
            if hasattr(self, name) and not self.properties.is_property_set(name):
                setattr(self, name, value)
        return context.window_manager.invoke_props_dialog(self)


class F4X_OT_recolour(_Edit, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Change the color of the selection."""

    bl_idname, bl_label = "f4x.recolour", "Recolor"

    rgb: FloatVectorProperty(  # type: ignore[valid-type]
        name="Color", subtype="COLOR_GAMMA", size=3, default=(0.9, 0.1, 0.1), min=0.0, max=1.0
    )
    hue: BoolProperty(name="Hue Only", description="Change the hue and keep the brightness")  # type: ignore[valid-type]
    shading: BoolProperty(
        name="Keep Shading", description="Keep shadows and texture visible under the new color", default=True
    )  # type: ignore[valid-type]
    strength: FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0, subtype="FACTOR")  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return a change of the whole colour or of the hue only."""
        rgb = tuple(round(round(255 * value) / 255, PLACES) for value in self.rgb)  # the list of edits has its hex code
        mode = {"mode": "hue"} if self.hue else {"keep_luminance": self.shading}
        return Recolour(
            scene_object.selected_ids, rgb, strength=round(self.strength, 4), frames=_span(scene_object), **mode
        )


class F4X_OT_style(_Edit, bpy.types.Operator):  # noqa: N801
    """Apply a look to the selection, such as a material or a mood."""

    bl_idname, bl_label = "f4x.style", "Look"

    look: EnumProperty(name="Look", items=[(name, name.capitalize(), "") for name in STYLES])  # type: ignore[valid-type]
    strength: FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0, subtype="FACTOR")  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return a look from the table."""
        return Style(scene_object.selected_ids, self.look, round(self.strength, 4), _span(scene_object))


class F4X_OT_opacity(_EditWithShadow, bpy.types.Operator):  # noqa: N801
    """Make the selection more or less transparent."""

    bl_idname, bl_label = "f4x.opacity", "Opacity"

    factor: FloatProperty(name="Factor", default=0.5, min=0.0, max=10.0, soft_max=1.0)  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return a change of the opacity by a factor."""
        return Opacity(scene_object.selected_ids, round(self.factor, 4), _span(scene_object))


class F4X_OT_remove(_EditWithShadow, bpy.types.Operator):  # noqa: N801
    """Remove the selection from the scene. Restore brings it back."""

    bl_idname, bl_label = "f4x.remove", "Remove"

    def operation(self, scene_object):
        """Return the removal of the selection, in the time span or for the whole clip."""
        return Delete(scene_object.selected_ids, _span(scene_object))


class F4X_OT_extract(_Edit, bpy.types.Operator):  # noqa: N801
    """Remove everything except the selection. Restore brings it back."""

    bl_idname, bl_label = "f4x.extract", "Keep Only"

    def operation(self, scene_object):
        """Return the removal of everything else, in the time span or for the whole clip."""
        return Extract(scene_object.selected_ids, _span(scene_object))


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


class F4X_OT_transform(_EditWithShadow, _Dialog, bpy.types.Operator):  # noqa: N801
    """Move, rotate and scale the selection, at once or gradually over time."""

    bl_idname, bl_label = "f4x.transform", "Move, Rotate, Scale"

    move: FloatVectorProperty(name="Move", description="Distance along Blender's axes", subtype="TRANSLATION")  # type: ignore[valid-type]
    turn: FloatVectorProperty(name="Rotate", description="Rotation about Blender's axes", subtype="EULER")  # type: ignore[valid-type]
    size: FloatProperty(name="Scale", default=1.0, min=0.001, max=1000.0, soft_min=0.1, soft_max=10.0)  # type: ignore[valid-type]
    pivot: EnumProperty(  # type: ignore[valid-type]
        name="Pivot",
        items=(
            ("centroid", "Center", "The center of the selection"),
            ("base", "Base", "The lowest point of the selection"),
        ),
    )
    over_time: BoolProperty(name="Over Time", description="Start at the first frame and finish at the last frame")  # type: ignore[valid-type]
    first: IntProperty(name="First Frame", min=0)  # type: ignore[valid-type]
    last: IntProperty(name="Last Frame", min=0)  # type: ignore[valid-type]

    def draw(self, context):
        """Draw the settings; the frames are greyed out unless Over Time is on."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("move", "turn", "size", "pivot", "shadow", "over_time"):
            layout.prop(self, name)
        column = layout.column(align=True)
        column.active = self.over_time
        column.prop(self, "first")
        column.prop(self, "last")

    def operation(self, scene_object):
        """Return the transform along the scene's axes; its rotation is a rotation vector in degrees."""
        turn, axes = np.rad2deg(Euler(self.turn).to_quaternion().to_exponential_map()), scene_object.axes
        return Transform(
            scene_object.selected_ids,
            translate=axes.way_in_scene(self.move),
            rotate=axes.turn_in_scene(turn),
            scale=round(self.size, 6),
            pivot=self.pivot,
            frames=(float(self.first), float(self.last)) if self.over_time else None,
        )


class F4X_OT_duplicate(_EditWithShadow, _Dialog, bpy.types.Operator):  # noqa: N801
    """Copy the selection to another place or time."""

    bl_idname, bl_label = "f4x.duplicate", "Duplicate"

    offset: FloatVectorProperty(  # type: ignore[valid-type]
        name="Offset",
        description="Distance between copies along Blender's axes",
        subtype="TRANSLATION",
        default=(0.2, 0.0, 0.0),
    )
    time_shift: FloatProperty(name="Time Offset", description="Frames by which copies play later; negative: earlier")  # type: ignore[valid-type]
    count: IntProperty(name="Copies", default=1, min=1, max=100)  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return the copies, offset along the scene's axes."""
        ids = scene_object.selected_ids
        return Duplicate(ids, scene_object.axes.way_in_scene(self.offset), round(self.time_shift, 3), self.count)


class F4X_OT_freeze(_EditWithShadow, _Dialog, bpy.types.Operator):  # noqa: N801
    """Stop the motion of the selection from one frame on, or between two frames."""

    bl_idname, bl_label = "f4x.freeze", "Freeze"

    first: IntProperty(name="From Frame", min=0)  # type: ignore[valid-type]
    goes_on: BoolProperty(name="Resume Later", description="Continue the motion after the last frame")  # type: ignore[valid-type]
    last: IntProperty(name="Until Frame", min=0)  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return the stop, with or without an end."""
        return Freeze(scene_object.selected_ids, float(self.first), float(self.last) if self.goes_on else None)


class F4X_OT_retime(_EditWithShadow, _Dialog, bpy.types.Operator):  # noqa: N801
    """Play the motion of the selection faster, slower or backwards."""

    bl_idname, bl_label = "f4x.retime", "Retime"

    speed: FloatProperty(name="Speed", default=0.5, min=0.001, max=1000.0, soft_min=0.1, soft_max=10.0)  # type: ignore[valid-type]
    backwards: BoolProperty(name="Backwards", description="Play backwards at normal speed; Speed is ignored")  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return the change of speed, in the time span or over the whole clip."""
        ids = scene_object.selected_ids
        span = _span(scene_object)
        return Reverse(ids, span) if self.backwards else Retime(ids, round(self.speed, 4), span)


class F4X_OT_name_selection(_Dialog, bpy.types.Operator):  # noqa: N801
    """Name the selection, so that you can select it by name and use the name in sentences."""

    bl_idname, bl_label = "f4x.name_selection", "Name Selection"

    called: StringProperty(name="Name", default="subject")  # type: ignore[valid-type]

    def operation(self, scene_object):
        """Return the naming of the selection; names travel with the scene file."""
        from ...f4x_core.edit.phrases import refuse_as_name  # a part of the grammar, which waits until somebody speaks

        refuse_as_name(self.called)
        return Name(scene_object.selected_ids, self.called)


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


@dataclass(frozen=True)
class Understood:
    """The reading of a sentence: a selection, or edits to choose from."""

    selecting: SelectingSentence | None = None
    proposal: Proposal | None = None
    descriptions: Sequence[str] = ()
    """Each candidate of the proposal in words."""


class F4X_OT_plan(SearchOperator, bpy.types.Operator):  # noqa: N801
    """Show what the sentence would do, without changing the scene. A sentence that selects does so at once."""

    bl_idname, bl_label = "f4x.plan", "Plan"
    bl_options = {"REGISTER"}  # noqa: RUF012 - a preview is no step of undo
    section, title = "EDIT", "Reading the sentence"

    sentence: StringProperty(name="Say", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    readings: IntProperty(
        name="Readings", description="Maximum number of interpretations to compare", default=1, min=1, max=10
    )  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Take the sentence from the panel, where the button does not bring one."""
        scene_object = SceneObject.of(context.object)
        self.sentence = self.sentence or scene_object.state.sentence
        return self.search(context)

    def work(self, scene_object):
        """Read the sentence as one that selects, or else as one that edits."""
        state = scene_object.state
        state.sentence = self.sentence
        drop_plan(scene_object)
        sentence, readings, meters = self.sentence, self.readings, scene_object.meters
        base, scene, asker = scene_object.base, scene_object.edited, scene_object.context

        def search(progress: Progress) -> Understood:
            # Not above: Blender starts more often than somebody speaks.
            from ...f4x_core.edit.lengths import in_units
            from ...f4x_core.edit.plan import propose
            from ...f4x_core.edit.selecting import read_selecting

            cache.wait_until_prepared(base, progress)
            if selecting := read_selecting(scene, sentence, asker):
                return Understood(selecting)
            said = in_units(sentence, meters) if meters else sentence
            proposal = propose(scene, said, asker, candidates=readings)
            return Understood(
                proposal=proposal,
                descriptions=["\n".join(plan_lines(scene, one.operations, asker.frame)) for one in proposal.candidates],
            )

        return search

    def failed(self, scene_object, error):
        """Show the error below the sentence, where it is asked what was meant; once is enough."""
        if not isinstance(error, EXPECTED):
            raise error
        state = scene_object.state
        state.answer = error_line(error)
        state.instead = error.instead if isinstance(error, Doubt) else ""
        return {"CANCELLED"}

    def take(self, context, scene_object, found):
        """Select, or show the readings and preview the best."""
        state = scene_object.state
        if selecting := found.selecting:
            marking.combine(scene_object, selecting.chosen, selecting.mode)
            state.called = selecting.words if selecting.mode == "SET" else ""
            line = f"{state.selected:,} of {state.total:,} Gaussians selected."
            state.answer = panel_words(" ".join([line, *selecting.remarks]))
            end_step("Select")
            return
        proposal = found.proposal
        assert proposal is not None  # it is one or the other
        for candidate, description in zip(proposal.candidates, found.descriptions, strict=True):
            row = state.readings.add()
            row.name = candidate.why or "as said"
            row.operations = json.dumps([operation.to_json() for operation in candidate.operations])
            row.description = description
            row.first, row.last = _when(candidate.operations, scene_object.base.cameras.times)
        state.answer = panel_words(" ".join(proposal.notes))
        state.slower = _speed_of_everything(proposal.chosen.operations)
        state.reading_index = proposal.best
        display.preview(scene_object, True)


class F4X_OT_pick_reading(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Preview this interpretation of the sentence."""

    bl_idname, bl_label = "f4x.pick_reading", "Pick"
    bl_options = {"REGISTER"}  # noqa: RUF012

    number: IntProperty(name="Number", min=0)  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Choose and preview the reading."""
        scene_object.state.reading_index = self.number
        display.preview(scene_object, True)


class F4X_OT_apply_plan(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Apply the chosen interpretation of the sentence to the scene."""

    bl_idname, bl_label = "f4x.apply_plan", "Apply"

    def act(self, context, scene_object):
        """Append the edits to the history, together with their sentence."""
        if not scene_object.state.readings:
            raise F4xError("Nothing is planned; type a sentence and press Plan first.")
        scene_object.set_stack(scene_object.with_reading())
        forget_readings(scene_object)
        display.refresh(scene_object)


class F4X_OT_drop_plan(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Discard the plan and end the preview. Ctrl-Z over the viewport does so, too, and undoes nothing else then."""

    bl_idname, bl_label = "f4x.drop_plan", "Discard"
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, context):
        """Return True if something is planned."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Nothing is planned")
        return context.mode == "OBJECT" and len(SceneObject.of(context.object).state.readings) > 0

    def act(self, context, scene_object):
        """Forget the plan and show the pending edits."""
        drop_plan(scene_object)


class F4X_OT_slow_clip(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Play the whole clip slower, its camera too, in place of what is planned. It sets Speed in the panel Motion."""

    bl_idname, bl_label = "f4x.slow_clip", "Slow the Whole Clip"

    speed: FloatProperty(name="Speed", default=0.5, min=0.001, max=1000.0)  # type: ignore[valid-type]

    def act(self, context, scene_object):
        """Set the speed; where the frame range ended with the clip, it does so again."""
        drop_plan(scene_object)
        root, timing = scene_object.root, clip_time.timing_of(scene_object.root)
        ends = context.scene.frame_end == round(float(timing.frames_of(root[clip_time.LAST])))
        clip_time.place(root, timing.start, timing.rate * self.speed)
        if ends:
            context.scene.frame_end = round(float(clip_time.timing_of(root).frames_of(root[clip_time.LAST])))


def _speed_of_everything(operations: tuple[Operation, ...]) -> float:
    """Return the speed at which a plan plays everything all the time, where that is slower and all it does; else 0."""
    match operations:
        case (Retime(select=All(), speed=speed, frames=None),) if speed < 1:
            return speed
    return 0.0


def _when(operations: Sequence[Operation], times: np.ndarray) -> tuple[float, float]:
    """Return the first and last of the clip frames `times (T,)` at which operations change anything; the clip's where none does."""
    last = float(times[-1])
    changed = [
        time
        for time in times.tolist()
        if any(holds(each.span, time) or each.fraction(time, last) > 0 for each in operations)
    ]
    return (changed[0], changed[-1]) if changed else (float(times[0]), last)


def forget_readings(scene_object: SceneObject) -> None:
    """Discard the plan and end the preview, which the viewport still shows."""
    state = scene_object.state
    state.readings.clear()
    state.answer, state.instead, state.slower = "", "", 0.0
    scene_object.show_preview(None)


def drop_plan(scene_object: SceneObject) -> None:
    """Discard the plan, and show the pending edits again where its preview was shown."""
    shown = PREVIEW in scene_object.root
    forget_readings(scene_object)
    if shown:
        display.preview(scene_object, False)


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
    F4X_OT_recolour,
    F4X_OT_style,
    F4X_OT_opacity,
    F4X_OT_remove,
    F4X_OT_extract,
    F4X_OT_restore,
    F4X_OT_transform,
    F4X_OT_duplicate,
    F4X_OT_freeze,
    F4X_OT_retime,
    F4X_OT_name_selection,
    F4X_OT_history,
    F4X_OT_save_edits,
    F4X_OT_save_as,
    F4X_OT_plan,
    F4X_OT_pick_reading,
    F4X_OT_apply_plan,
    F4X_OT_drop_plan,
    F4X_OT_slow_clip,
)


def register() -> None:
    """Let Ctrl-Z over viewports discard what is planned; Blender's own Undo gets the key where nothing is."""
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is not None:  # there is none without a window
        keymap = keys.keymaps.new("3D View Generic", space_type="VIEW_3D")
        command = {"oskey": True} if sys.platform == "darwin" else {"ctrl": True}
        _keys.append((keymap, keymap.keymap_items.new("f4x.drop_plan", "Z", "PRESS", **command)))


def unregister() -> None:
    """Undo `register`."""
    for keymap, item in _keys:
        keymap.keymap_items.remove(item)
    _keys.clear()
