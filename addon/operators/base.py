"""The base of all operators of the sidebar: they need a scene and report errors as one sentence."""

from __future__ import annotations

import bpy

from ...f4x_core.errors import F4xError
from ..common.lines import CATEGORY
from ..common.wording import Reporting
from ..scene.scene_object import SceneObject, why_not


class SceneOperator(Reporting):
    """Mixin: `act(context, scene_object)` does the work."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender at registration

    @classmethod
    def poll(cls, context):
        """Return True if there is an imported scene that can be changed."""
        reason = why_not(context.object)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def act(self, context: bpy.types.Context, scene_object: SceneObject) -> None:
        """Do the work of the operator. Raises F4xError if that is not possible."""
        raise NotImplementedError

    def execute(self, context):
        """Call `act`."""
        self.act(context, SceneObject.of(context.object))
        return {"FINISHED"}


class Section:
    """Base of the panels that need an imported scene."""

    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", CATEGORY

    @classmethod
    def poll(cls, context):
        """Show the panel if there is an imported scene."""
        return SceneObject.of(context.object) is not None


class DescribedChoice:
    """Mixin of operators whose buttons differ in one property: its items have their tooltips."""

    choice = "how"
    """Name of the property."""

    @classmethod
    def description(cls, context, properties):
        """Return the tooltip of a button: that of its choice."""
        return properties.bl_rna.properties[cls.choice].enum_items[getattr(properties, cls.choice)].description


def require_viewport(context: bpy.types.Context) -> None:
    """Raise F4xError if a tool that follows the mouse was started elsewhere than in a 3D viewport."""
    if context.area is None or context.area.type != "VIEW_3D":
        raise F4xError("Start this tool from a 3D viewport.")
