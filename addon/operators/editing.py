"""Operators that change what is selected: each appends an operation of the core to the pending edits, and shows them."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    StringProperty,
)
from mathutils import Euler

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
from ...f4x_core.edit.styles import STYLES
from ...f4x_core.language.lexicon import PLACES
from ..edits import display
from ..scene.scene_object import SceneObject
from .base import SceneOperator


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


CLASSES = (
    F4X_OT_recolour,
    F4X_OT_style,
    F4X_OT_opacity,
    F4X_OT_remove,
    F4X_OT_extract,
    F4X_OT_transform,
    F4X_OT_duplicate,
    F4X_OT_freeze,
    F4X_OT_retime,
    F4X_OT_name_selection,
)
