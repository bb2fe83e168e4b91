"""What a person can call from Blender's menus and search."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..f4x_core.errors import F4xError
from .import_scene import import_scene


class F4X_OT_import_scene(bpy.types.Operator, ImportHelper):  # noqa: N801 - Blender wants this form
    """Import a Feature4X scene: Gaussians, the scaffold that moves them, and the clip's camera."""

    bl_idname = "f4x.import_scene"
    bl_label = "Import Feature4X Scene"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - read by Blender at registration

    filename_ext = ".f4x"
    filter_glob: StringProperty(default="*.f4x", options={"HIDDEN"})  # type: ignore[valid-type]
    set_up_render: BoolProperty(  # type: ignore[valid-type]
        name="Set Up Render", description="Take over the clip's size, rate, frame range and camera", default=True
    )

    def execute(self, context):
        """Import the chosen file."""
        try:
            root = import_scene(Path(self.filepath), set_up_render=self.set_up_render)
        except F4xError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for item in context.selected_objects:
            item.select_set(False)
        root.select_set(True)
        context.view_layer.objects.active = root
        return {"FINISHED"}

    def invoke(self, context, event):
        """Ask for a file, or for the options only when one was dropped into the viewport."""
        return self.invoke_popup(context) if self.filepath else super().invoke(context, event)


class F4X_FH_scene(bpy.types.FileHandler):  # noqa: N801
    """Dropping a scene file into a viewport imports it."""

    bl_idname = "F4X_FH_scene"
    bl_label = "Feature4X Scene"
    bl_import_operator = "f4x.import_scene"
    bl_file_extensions = ".f4x"

    @classmethod
    def poll_drop(cls, context):
        """Accept drops into 3D viewports."""
        return context.area is not None and context.area.type == "VIEW_3D"


CLASSES = (F4X_OT_import_scene, F4X_FH_scene)
