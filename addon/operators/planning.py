"""Operators on a sentence: reading it, previewing what it would do, and applying or discarding that plan."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import FloatProperty, IntProperty, StringProperty

from ...f4x_core.edit.change import holds
from ...f4x_core.edit.operations import Operation, Retime
from ...f4x_core.edit.plan_lines import plan_lines
from ...f4x_core.edit.selects import All
from ...f4x_core.errors import F4xError
from ...f4x_core.language.refusal import Doubt
from ...f4x_core.progress import Progress
from ...f4x_core.troubles import EXPECTED
from ..common.undo import end_step
from ..common.wording import error_line, panel_words
from ..edits import display, marking
from ..scene import cache, clip_time
from ..scene.scene_object import PREVIEW, SceneObject
from .base import SceneOperator
from .searching import SearchOperator

if TYPE_CHECKING:
    from ...f4x_core.edit.plan import Proposal
    from ...f4x_core.edit.selecting import SelectingSentence

_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []
READINGS = 4
"""Ways to carry out a sentence that are offered when the plain one is not it."""


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


CLASSES = (
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
