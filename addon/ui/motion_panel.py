"""The panel *Motion*: when the clip plays, and the tools for its nodes. Two functions draw its halves, for other panels too."""

from __future__ import annotations

import bpy

from ...f4x_core.language.lexicon import plural
from ..operators.base import Section
from ..rig.motion_edits import unwritten
from ..rig.scaffold import HANDLE, layer_of
from ..scene.clip_time import TIME, is_still
from ..scene.scene_object import SceneObject


def draw_time(layout: bpy.types.UILayout, root: bpy.types.Object) -> None:
    """Draw when the clip of a root plays; nothing for a still."""
    if TIME not in root or is_still(root):
        return
    column = layout.column(align=True)
    row = column.row(align=True)
    row.prop(root.f4x, "start_frame", text="Start")
    row.prop(root.f4x, "speed")
    row = column.row(align=True)
    time = row.row(align=True)
    time.active = root.f4x.animate_time
    time.prop(root, f'["{TIME}"]', text="Time")
    row.prop(root.f4x, "animate_time", text="", icon="ACTION")


def draw_nodes(layout: bpy.types.UILayout, context: bpy.types.Context, scene_object: SceneObject) -> None:
    """Draw the switch that shows the nodes of a scene, and the tools that move them; nothing where it has none."""
    if layer_of(scene_object.root) is None:
        return
    column = layout.column(align=True)
    row = column.row(align=True)
    row.prop(scene_object.state, "show_nodes", icon="EMPTY_AXIS", toggle=1)
    row.operator("f4x.grab_nodes", text="Grab")
    row.operator("f4x.add_handles", text="Handles")
    if any(HANDLE in item for item in scene_object.root.children_recursive):
        row.operator("f4x.remove_handles", text="", icon="X")
    moved = 0 if context.screen.is_animation_playing else unwritten(scene_object)
    if moved:
        text = f"Write Back {moved} Moved {plural('Node', moved)}"
        column.operator("f4x.write_motion", text=text, icon="FILE_TICK")


class F4X_PT_motion(Section, bpy.types.Panel):  # noqa: N801 - Blender wants this form
    """Time of the clip on the timeline, and tools for its nodes."""

    bl_label = "Motion"

    @classmethod
    def poll(cls, context):
        """Show the panel if there is an imported scene that plays."""
        return super().poll(context) and not is_still(SceneObject.of(context.object).root)

    def draw(self, context):
        """Draw time, then nodes."""
        scene_object = SceneObject.of(context.object)
        draw_time(self.layout, scene_object.root)
        draw_nodes(self.layout, context, scene_object)


CLASSES = (F4X_PT_motion,)
