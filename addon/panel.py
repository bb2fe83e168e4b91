"""The panels of the sidebar (N): Say, Ask, Selection, Change, History. They only draw; operators do the work."""

from __future__ import annotations

import json

import bpy

from . import cleanup_operators, display, edit_operators, marking, point_edits, viewport
from .edit_fields import draw_fields
from .gesture_operators import TOOLS
from .lines import draw_lines
from .render_setup import clip_camera
from .scaffold_rig import layer_of
from .scene_object import SceneObject

CATEGORY = "Feature4X"
LEVELS = "▁▂▃▄▅▆▇█"
"""Characters for the bars of the histogram, lowest first."""


def _bars(counts: list[int]) -> str:
    """A histogram as one line of text. Heights are square roots, because most Gaussians have a score near 0."""
    highest = max(counts, default=0) or 1
    return "".join(LEVELS[round((count / highest) ** 0.5 * (len(LEVELS) - 1))] for count in counts)


EXAMPLES = "Such as: delete the car; slow the dog down to half; copy the dog to the left"
"""What stands where answers do while there is none."""
ANSWER_LINES = 4
"""Lines kept free for an answer, so that it moves no button under the mouse."""


class _Section:
    """Base of the panels that need an imported scene."""

    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", CATEGORY

    @classmethod
    def poll(cls, context):
        """Show the panel if there is an imported scene."""
        return SceneObject.of(context.object) is not None


class F4X_UL_names(bpy.types.UIList):  # noqa: N801 - Blender wants this form
    """List of named selections."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_name, index):
        """Draw the name and the number of Gaussians."""
        row = layout.row()
        row.label(text=item.name, icon="GROUP_VERTEX")
        row.label(text=f"{item.count:,}")


class F4X_UL_history(bpy.types.UIList):  # noqa: N801
    """List of edits, first to last."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_name, index):
        """Draw a checkbox, the edit in words and a button that deletes it."""
        row = layout.row(align=True)
        for how, drawn in (("TOGGLE", "CHECKBOX_HLT" if item.enabled else "CHECKBOX_DEHLT"), ("REMOVE", "X")):
            if how == "REMOVE":
                words = row.row()
                words.active = item.enabled
                words.label(text=item.name)
            button = row.operator("f4x.history", text="", icon=drawn, emboss=False)
            button.how, button.edit_id = how, item.edit_id


class F4X_PT_scene(bpy.types.Panel):  # noqa: N801
    """The active scene, and whether its edits are saved in its file."""

    bl_label = "Scene"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", CATEGORY

    def draw(self, context):
        """Draw the scene, or a button to import one."""
        layout = self.layout
        scene_object = SceneObject.of(context.object)
        if scene_object is None:
            several = bool(SceneObject.among(context.scene.objects))
            layout.label(text="Select an object of a scene" if several else "No scene imported yet", icon="INFO")
            layout.operator("f4x.import_scene", text="Import Scene…", icon="IMPORT")
            return
        row = layout.row()
        row.label(text=scene_object.name, icon="OUTLINER_OB_POINTCLOUD")
        nodes = layer_of(scene_object.root)
        if nodes is not None:
            row.prop(nodes, "hide_viewport", text="", icon="EMPTY_AXIS", emboss=False)
        if not viewport.shows_picture(context.scene, context.space_data):
            layout.operator("f4x.show_picture", icon="SHADING_RENDERED")
        if not scene_object.path.exists():
            layout.operator("f4x.find_scene", text="Find Scene File…", icon="ERROR")
        touched = "" if context.screen.is_animation_playing else point_edits.summary(scene_object)
        row = layout.row()
        row.scale_y = 1.2
        if scene_object.holds_edits:
            saved = scene_object.is_saved
            text = "Save Edits to Scene" if saved and touched else scene_object.saving
            row.operator("f4x.save_edits", text=text, icon="FILE_TICK")
            row.active = bool(touched) or not saved
        else:
            row.operator("f4x.save_as", text="Save As Scene…", icon="FILE_TICK")
        column = layout.column(align=True)
        column.operator("f4x.align_floor", icon="GRID")
        row = column.row(align=True)
        row.operator("f4x.align_points")
        row.operator("f4x.scale_length")
        if touched:
            draw_lines(layout, context, touched, "ERROR")
            row = layout.row(align=True)
            row.operator("f4x.take_over_points")
            row.operator("f4x.put_back_points", text="", icon="LOOP_BACK")
        camera = clip_camera(scene_object.root)
        if camera is not None and context.scene.camera != camera:
            layout.operator("f4x.set_up_render", icon="OUTLINER_OB_CAMERA")
        draw_lines(layout, context, scene_object.state.notice, "ERROR")
        draw_lines(layout, context, scene_object.state.uncovered, "INFO")


class F4X_PT_say(_Section, bpy.types.Panel):  # noqa: N801
    """Editing by sentences."""

    bl_label = "Say"

    def draw(self, context):
        """Draw the sentence, what it would do, and other readings."""
        layout, state = self.layout, SceneObject.of(context.object).state
        row = layout.row(align=True)
        row.prop(state, "sentence", text="", icon="CONSOLE", placeholder="make the dog red from second 2")
        row.operator("f4x.plan", text="", icon="PLAY").readings = 1
        if state.readings:
            self._draw_readings(layout, context, state)
        draw_lines(layout, context, state.answer or EXAMPLES, "INFO", min_lines=ANSWER_LINES)
        if state.slower:
            layout.operator("f4x.slow_clip", icon="TIME").speed = state.slower
        if state.instead:
            layout.operator("f4x.plan", text="Read It So", icon="CHECKMARK").sentence = state.instead

    def _draw_readings(self, layout, context, state):
        """Draw what the sentence would do, and the buttons that do it."""
        box = layout.box()
        for number, reading in enumerate(state.readings):
            picked = number == state.reading_index
            if len(state.readings) > 1:
                button = box.operator(
                    "f4x.pick_reading",
                    text=f"{number + 1}  {reading.name}",
                    icon="RADIOBUT_ON" if picked else "RADIOBUT_OFF",
                    emboss=False,
                )
                button.number = number
            if picked:
                draw_lines(box, context, reading.description)
        row = box.row(align=True)
        row.operator("f4x.apply_plan", icon="CHECKMARK")
        row.prop(state, "preview", text="", icon="HIDE_OFF" if state.preview else "HIDE_ON")
        row.operator("f4x.drop_plan", text="", icon="X")
        if len(state.readings) == 1:
            again = layout.operator("f4x.plan", text="Other Readings", icon="VIEWZOOM")
            again.readings = edit_operators.READINGS


class F4X_PT_ask(_Section, bpy.types.Panel):  # noqa: N801
    """Selection by words, a point or a box."""

    bl_label = "Ask"

    def draw(self, context):
        """Draw the words, the prompts and the threshold."""
        layout, state = self.layout, SceneObject.of(context.object).state
        row = layout.row(align=True)
        row.prop(state, "mode", expand=True, icon_only=True)
        row.separator()
        row.operator("f4x.query_point", icon="EYEDROPPER")
        row.operator("f4x.query_box", icon="SELECT_SET")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.prop(state, "text", text="", icon="VIEWZOOM", placeholder="dog, cat")
        row.operator("f4x.query_text", text="Query")
        column.prop(state, "negatives", text="", icon="REMOVE", placeholder="but not …")
        row = layout.row(align=True)
        for tool in TOOLS:
            row.operator("wm.tool_set_by_id", text=tool.bl_label.rpartition(" ")[2]).name = tool.bl_idname
        row.prop(state, "through", text="", icon="XRAY")
        row.prop(state, "whole", text="", icon="OBJECT_DATA")
        column = layout.column(align=True)
        column.active = state.live
        row = column.row()  # there without scores too: buttons that move are missed
        row.alignment = "CENTER"
        row.label(text=_bars(json.loads(state.histogram or f"[{', '.join('0' * marking.BARS)}]")))
        column.prop(state, "threshold", slider=True)
        row = layout.row()
        selected, total = display.last_counts(SceneObject.of(context.object))
        row.label(text=f"{selected:,} of {total:,} selected", icon="RESTRICT_SELECT_OFF")
        row.prop(state, "show_score", text="", icon="COLORSET_01_VEC", toggle=True)


class F4X_PT_selection(_Section, bpy.types.Panel):  # noqa: N801
    """Tools for the selection."""

    bl_label = "Selection"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender

    def draw(self, context):
        """Draw buttons that change, hide and name the selection."""
        layout, state = self.layout, SceneObject.of(context.object).state
        row = layout.row(align=True)
        for how in ("GROW", "SHRINK"):
            row.operator("f4x.change_selection", text=how.capitalize()).how = how
        row.prop(state, "reach", text="")
        row = layout.row(align=True)
        for how in ("INVERT", "ALL", "NONE"):
            row.operator("f4x.change_selection", text=how.capitalize()).how = how
        row = layout.row(align=True)
        for what, text, icon in (
            ("SELECTED", "Hide", "HIDE_ON"),
            ("OTHERS", "Isolate", "ZOOM_SELECTED"),
            ("NOTHING", "Show All", "HIDE_OFF"),
        ):
            row.operator("f4x.hide", text=text, icon=icon).what = what
        row = layout.row(heading="Time Span")
        row.prop(state, "use_span", text="")
        frames = row.row(align=True)
        frames.active = state.use_span
        frames.prop(state, "first", text="")
        frames.prop(state, "last", text="")
        row = layout.row()
        row.template_list("F4X_UL_names", "", state, "names", state, "name_index", rows=2)
        column = row.column(align=True)
        column.operator("f4x.name_selection", text="", icon="ADD")
        if 0 <= state.name_index < len(state.names):
            column.operator("f4x.select_named", text="", icon="RESTRICT_SELECT_OFF").called = state.names[
                state.name_index
            ].name


class F4X_PT_change(_Section, bpy.types.Panel):  # noqa: N801
    """Buttons that edit the selection."""

    bl_label = "Change"

    def draw(self, context):
        """Draw buttons for colour, visibility, place and time."""
        layout, state = self.layout, SceneObject.of(context.object).state
        if state.use_span:
            layout.label(text=f"From frame {state.first} to {state.last}", icon="TIME")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.prop(state, "rgb", text="")
        row.operator("f4x.recolour").rgb = state.rgb
        row = column.row(align=True)
        row.prop(state, "opacity", text="", slider=True)
        row.operator("f4x.opacity").factor = state.opacity
        column.operator_menu_enum("f4x.style", "look", text="Look", icon="SHADING_RENDERED")
        row = layout.row(align=True)
        row.operator("f4x.remove", icon="TRASH")
        row.operator("f4x.extract")
        row.operator("f4x.restore", icon="LOOP_BACK")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("f4x.transform", text="Move, Rotate, Scale…", icon="ORIENTATION_GLOBAL")
        row.operator("f4x.edit_gizmo", text="", icon="GIZMO").edit_id = 0
        column.operator("f4x.duplicate", text="Duplicate…", icon="DUPLICATE")
        row = column.row(align=True)
        row.operator("f4x.freeze", text="Freeze…", icon="PAUSE")
        row.operator("f4x.retime", text="Retime…", icon="TIME")
        column = layout.column(align=True)
        column.operator("f4x.remove_floaters", icon="PARTICLES")
        if cleanup_operators.box_of(SceneObject.of(context.object)) is None:
            column.operator("f4x.add_crop_box", icon="CUBE")
        else:
            row = column.row(align=True)
            row.operator("f4x.crop", text="Keep Inside", icon="CUBE").keep = "INSIDE"
            row.operator("f4x.crop", text="Remove Inside").keep = "OUTSIDE"


class F4X_PT_history(_Section, bpy.types.Panel):  # noqa: N801
    """The edit stack."""

    bl_label = "History"

    def draw(self, context):
        """Draw the list, with buttons to move and delete edits, and the fields of the one that is picked."""
        layout, scene_object = self.layout, SceneObject.of(context.object)
        state = scene_object.state
        row = layout.row()
        row.template_list("F4X_UL_history", "", state, "history", state, "history_index", rows=4)
        column = row.column(align=True)
        if 0 <= state.history_index < len(state.history):
            item = state.history[state.history_index]
            for how, icon in (("UP", "TRIA_UP"), ("DOWN", "TRIA_DOWN")):
                button = column.operator("f4x.history", text="", icon=icon)
                button.how, button.edit_id = how, item.edit_id
            draw_lines(layout, context, item.name)
        column.separator()
        column.operator("f4x.history", text="", icon="TRASH").how = "CLEAR"
        draw_fields(layout, scene_object)


CLASSES = (
    F4X_UL_names,
    F4X_UL_history,
    F4X_PT_scene,
    F4X_PT_say,
    F4X_PT_ask,
    F4X_PT_selection,
    F4X_PT_change,
    F4X_PT_history,
)
