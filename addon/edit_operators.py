"""Changing what is selected: every operator appends operations of the core to the pending stack, and shows them."""

from __future__ import annotations

import json

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
from mathutils import Euler

from ..f4x_core.edit.operations import (
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
    Vector,
)
from ..f4x_core.edit.plan import propose
from ..f4x_core.edit.styles import STYLES
from ..f4x_core.edit.telling import told
from ..f4x_core.errors import F4xError
from ..f4x_core.language.lexicon import plural
from ..f4x_core.troubles import with_code
from . import display, session
from .axes import BLENDER_FROM_SCENE
from .panel_operators import SceneOperator
from .preferences import preferences
from .wording import panel_words

READINGS = 4
"""Ways to carry out a sentence that are offered when the plain one is not it."""


def _scene_vector(vector) -> Vector:
    """A vector along Blender's axes as one along the scene's axes (OpenCV)."""
    x, y, z = (BLENDER_FROM_SCENE[:3, :3].T @ np.array(vector, float)).tolist()
    return x, y, z


def _span(root: bpy.types.Object) -> Span | None:
    """The time span of the selection."""
    return (float(root.f4x.first), float(root.f4x.last)) if root.f4x.use_span else None


class _Edit(SceneOperator):
    """An operator that appends one operation on the selection."""

    def operation(self, root: bpy.types.Object) -> Operation:
        """Return the operation to append."""
        raise NotImplementedError

    def act(self, context, root):
        """Append and show it."""
        session.append(root, self.operation(root))
        display.refresh(root)
        self.report({"INFO"}, root.f4x.history[-1].name)


class _Dialog(_Edit):
    """An edit with a dialog for its settings."""

    def invoke(self, context, event):
        """Open the dialog; times default to the current frame and the end of the clip."""
        root = session.root_of(context.object)
        last = int(session.base_scene(root).cameras.times[-1])
        for name, value in (("first", round(session.frame_of(root))), ("last", last)):
            if hasattr(self, name) and not self.properties.is_property_set(name):
                setattr(self, name, value)
        return context.window_manager.invoke_props_dialog(self)


class F4X_OT_recolour(_Edit, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Change the colour of the selection."""

    bl_idname, bl_label = "f4x.recolour", "Recolour"

    rgb: FloatVectorProperty(  # type: ignore[valid-type]
        name="Colour", subtype="COLOR_GAMMA", size=3, default=(0.9, 0.1, 0.1), min=0.0, max=1.0
    )
    hue: BoolProperty(name="Hue Only", description="Change the hue and keep the brightness")  # type: ignore[valid-type]
    shading: BoolProperty(
        name="Keep Shading", description="Keep shadows and texture visible under the new colour", default=True
    )  # type: ignore[valid-type]
    strength: FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0, subtype="FACTOR")  # type: ignore[valid-type]

    def operation(self, root):
        """A colour change, of the whole colour or of the hue only."""
        rgb = tuple(round(value, 4) for value in self.rgb)
        mode = {"mode": "hue"} if self.hue else {"keep_luminance": self.shading}
        return Recolour(session.selected_ids(root), rgb, strength=round(self.strength, 4), frames=_span(root), **mode)


class F4X_OT_style(_Edit, bpy.types.Operator):  # noqa: N801
    """Apply a look to the selection, such as a material or a mood."""

    bl_idname, bl_label = "f4x.style", "Look"

    look: EnumProperty(name="Look", items=[(name, name.capitalize(), "") for name in STYLES])  # type: ignore[valid-type]
    strength: FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0, subtype="FACTOR")  # type: ignore[valid-type]

    def operation(self, root):
        """A look from the table."""
        return Style(session.selected_ids(root), self.look, round(self.strength, 4), _span(root))


class F4X_OT_opacity(_Edit, bpy.types.Operator):  # noqa: N801
    """Make the selection more or less transparent."""

    bl_idname, bl_label = "f4x.opacity", "Opacity"

    factor: FloatProperty(name="Factor", default=0.5, min=0.0, max=10.0, soft_max=1.0)  # type: ignore[valid-type]

    def operation(self, root):
        """Opacity times a factor."""
        return Opacity(session.selected_ids(root), round(self.factor, 4), _span(root))


class F4X_OT_remove(_Edit, bpy.types.Operator):  # noqa: N801
    """Remove the selection from the scene. Restore brings it back."""

    bl_idname, bl_label = "f4x.remove", "Remove"

    def operation(self, root):
        """Removal in the time span, or for the whole clip."""
        return Delete(session.selected_ids(root), _span(root))


class F4X_OT_extract(_Edit, bpy.types.Operator):  # noqa: N801
    """Remove everything except the selection. Restore brings it back."""

    bl_idname, bl_label = "f4x.extract", "Keep Only"

    def operation(self, root):
        """Removal of everything else in the time span, or for the whole clip."""
        return Extract(session.selected_ids(root), _span(root))


class F4X_OT_restore(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Bring back everything that was removed, by switching off the edits that remove something."""

    bl_idname, bl_label = "f4x.restore", "Restore"

    def act(self, context, root):
        """Switch off what removes."""
        stack = session.stack_of(root)
        removing = [edit for edit in stack.edits if edit.enabled and isinstance(edit.operation, Delete | Extract)]
        if not removing:
            raise F4xError("No active edit removes anything, so there is nothing to restore; see the History panel.")
        for edit in removing:
            stack = stack.enable(edit.id, False)
        session.set_stack(root, stack)
        display.refresh(root)


class F4X_OT_transform(_Dialog, bpy.types.Operator):  # noqa: N801
    """Move, rotate and scale the selection, at once or gradually over time."""

    bl_idname, bl_label = "f4x.transform", "Move, Rotate, Scale"

    move: FloatVectorProperty(name="Move", description="Distance along Blender's axes", subtype="TRANSLATION")  # type: ignore[valid-type]
    turn: FloatVectorProperty(name="Rotate", description="Rotation about Blender's axes", subtype="EULER")  # type: ignore[valid-type]
    size: FloatProperty(name="Scale", default=1.0, min=0.001, max=1000.0, soft_min=0.1, soft_max=10.0)  # type: ignore[valid-type]
    pivot: EnumProperty(  # type: ignore[valid-type]
        name="Pivot",
        items=(
            ("centroid", "Centre", "The centre of the selection"),
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
        for name in ("move", "turn", "size", "pivot", "over_time"):
            layout.prop(self, name)
        column = layout.column(align=True)
        column.active = self.over_time
        column.prop(self, "first")
        column.prop(self, "last")

    def operation(self, root):
        """The transform in the scene's axes; the rotation is a rotation vector in degrees."""
        turn = np.rad2deg(Euler(self.turn).to_quaternion().to_exponential_map())
        return Transform(
            session.selected_ids(root),
            translate=_scene_vector(self.move),
            rotate=_scene_vector(turn),
            scale=round(self.size, 6),
            pivot=self.pivot,
            frames=(float(self.first), float(self.last)) if self.over_time else None,
        )


class F4X_OT_duplicate(_Dialog, bpy.types.Operator):  # noqa: N801
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

    def operation(self, root):
        """In the scene's axes."""
        ids = session.selected_ids(root)
        return Duplicate(ids, _scene_vector(self.offset), round(self.time_shift, 3), self.count)


class F4X_OT_freeze(_Dialog, bpy.types.Operator):  # noqa: N801
    """Stop the motion of the selection from one frame on, or between two frames."""

    bl_idname, bl_label = "f4x.freeze", "Freeze"

    first: IntProperty(name="From Frame", min=0)  # type: ignore[valid-type]
    goes_on: BoolProperty(name="Resume Later", description="Continue the motion after the last frame")  # type: ignore[valid-type]
    last: IntProperty(name="Until Frame", min=0)  # type: ignore[valid-type]

    def operation(self, root):
        """With or without an end."""
        return Freeze(session.selected_ids(root), float(self.first), float(self.last) if self.goes_on else None)


class F4X_OT_retime(_Dialog, bpy.types.Operator):  # noqa: N801
    """Play the motion of the selection faster, slower or backwards."""

    bl_idname, bl_label = "f4x.retime", "Retime"

    speed: FloatProperty(name="Speed", default=0.5, min=0.001, max=1000.0, soft_min=0.1, soft_max=10.0)  # type: ignore[valid-type]
    backwards: BoolProperty(name="Backwards", description="Play backwards at normal speed; Speed is ignored")  # type: ignore[valid-type]

    def operation(self, root):
        """In the time span, or over the whole clip."""
        ids = session.selected_ids(root)
        return Reverse(ids, _span(root)) if self.backwards else Retime(ids, round(self.speed, 4), _span(root))


class F4X_OT_name_selection(_Dialog, bpy.types.Operator):  # noqa: N801
    """Name the selection, so that you can select it by name and use the name in sentences."""

    bl_idname, bl_label = "f4x.name_selection", "Name Selection"

    called: StringProperty(name="Name", default="thing")  # type: ignore[valid-type]

    def operation(self, root):
        """Names travel with the scene file."""
        return Name(session.selected_ids(root), self.called)


class F4X_OT_history(SceneOperator, bpy.types.Operator):  # noqa: N801
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

    @classmethod
    def description(cls, context, properties):
        """The tooltip of each button."""
        return cls.bl_rna.properties["how"].enum_items[properties.how].description

    def act(self, context, root):
        """Change the stack, and show it."""
        stack = session.stack_of(root)
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
        session.set_stack(root, stack)
        display.refresh(root)
        index = next((i for i, row in enumerate(root.f4x.history) if row.edit_id == self.edit_id), None)
        root.f4x.history_index = len(root.f4x.history) - 1 if index is None else index


class F4X_OT_save_edits(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Save the edits in the scene file, so that the f4x command and other Blender files use them too."""

    bl_idname, bl_label = "f4x.save_edits", "Save Edits to Scene"

    def act(self, context, root):
        """Write atomically; edits that others wrote in the meantime are merged, undone ones are taken out."""
        stack = session.save(root)
        display.refresh(root)
        self.report({"INFO"}, f"Saved {len(stack)} {plural('edit', len(stack))} in {session.path_of(root).name}")


class F4X_OT_plan(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Show what the sentence would do, without changing the scene."""

    bl_idname, bl_label = "f4x.plan", "Plan"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Ctrl-Z takes the edit back that a plan becomes, not the plan

    sentence: StringProperty(name="Say", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    readings: IntProperty(
        name="Readings", description="Maximum number of interpretations to compare", default=1, min=1, max=10
    )  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Take the sentence from the panel."""
        root = session.root_of(context.object)
        self.sentence = root.f4x.sentence
        try:
            self.act(context, root)
        except F4xError:  # the panel shows it, below the sentence; once is enough
            return {"CANCELLED"}
        return {"FINISHED"}

    def act(self, context, root):
        """Show the readings in the panel, or why the sentence was not understood."""
        state = root.f4x
        state.sentence = self.sentence
        forget_readings(root)
        try:
            session.asked_scene(root)
            scene, edit_context = session.edited_scene(root), session.context_of(root)
            proposal = propose(scene, self.sentence, edit_context, candidates=self.readings)
        except F4xError as error:
            state.answer = panel_words(with_code(error))
            raise
        for candidate in proposal.candidates:
            row = state.readings.add()
            row.name = candidate.why or "as said"
            row.operations = json.dumps([operation.to_json() for operation in candidate.operations])
            row.description = "\n".join(told(scene, candidate.operations, edit_context.frame))
        state.answer = " ".join(proposal.notes)
        state.reading_index = proposal.best
        state.preview = True


class F4X_OT_pick_reading(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Preview this interpretation of the sentence."""

    bl_idname, bl_label = "f4x.pick_reading", "Pick"
    bl_options = {"REGISTER"}  # noqa: RUF012

    number: IntProperty(name="Number", min=0)  # type: ignore[valid-type]

    def act(self, context, root):
        """Choose and preview the reading."""
        root.f4x.reading_index = self.number
        root.f4x.preview = True


class F4X_OT_apply_plan(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Apply the chosen interpretation of the sentence to the scene."""

    bl_idname, bl_label = "f4x.apply_plan", "Apply"

    def act(self, context, root):
        """Append the edits to the history, together with their sentence."""
        if not root.f4x.readings:
            raise F4xError("Nothing is planned; type a sentence and press Plan first.")
        session.set_stack(root, session.with_reading(root))
        forget_readings(root)
        display.refresh(root)


class F4X_OT_drop_plan(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Discard the plan and end the preview."""

    bl_idname, bl_label = "f4x.drop_plan", "Discard"
    bl_options = {"REGISTER"}  # noqa: RUF012

    def act(self, context, root):
        """Back to the pending edits."""
        forget_readings(root)
        display.refresh(root)


def forget_readings(root: bpy.types.Object) -> None:
    """Discard the plan and end the preview."""
    state = root.f4x
    state.readings.clear()
    state.answer = ""
    if state.preview:
        state.preview = False


@persistent
def _save_along(path: str) -> None:
    """Save the edits when the .blend is saved, if the preferences ask for it."""
    settings = preferences()
    for root in [item for item in bpy.data.objects if session.PATH in item and not session.is_linked(item)]:
        try:
            if settings is not None and settings.save_edits and not session.is_saved(root):
                session.save(root)
            session.remember(root)
        except F4xError as error:  # the .blend keeps the edits, and is saved all the same
            root.f4x.answer = str(error)


def register() -> None:
    """Add the handler."""
    bpy.app.handlers.save_pre.append(_save_along)


def unregister() -> None:
    """Undo `register`."""
    bpy.app.handlers.save_pre.remove(_save_along)


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
    F4X_OT_plan,
    F4X_OT_pick_reading,
    F4X_OT_apply_plan,
    F4X_OT_drop_plan,
)
