"""What all operators of the sidebar have in common: a scene to work on, and one sentence where something is wrong."""

from __future__ import annotations

import bpy

from ..f4x_core.errors import F4xError
from . import session


class SceneOperator:
    """Mixin: `act(context, root)` does the work; F4xError becomes a report and leaves nothing half done."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender at registration

    @classmethod
    def poll(cls, context):
        """There is an imported scene."""
        if session.root_of(context.object) is None:
            cls.poll_message_set("Import a Feature4X scene, or select one of its objects")
            return False
        return True

    def act(self, context: bpy.types.Context, root: bpy.types.Object) -> None:
        """Do it; F4xError says why not."""
        raise NotImplementedError

    def execute(self, context):
        """Call `act`, and report what it refuses."""
        try:
            self.act(context, session.root_of(context.object))
        except F4xError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}
