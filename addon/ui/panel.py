"""The panels of the sidebar (N): Scene, Select, Edit, Edits, Clean and Place. They only draw; operators do the work."""

from __future__ import annotations

import json

import bpy

from ...f4x_core.errors import F4xError
from ..common.gaussian_attributes import draws_splats
from ..common.lines import CATEGORY, draw_lines
from ..common.render_settings import ENGINE
from ..common.wording import Reporting
from ..edits import listing, marking
from ..edits.fields import draw_fields
from ..io.render_setup import clip_camera
from ..jobs import runner
from ..operators import baking, cleanup, planning, point_edits
from ..operators.base import Section
from ..operators.gestures import TOOLS
from ..operators.searching import draw_search
from ..render import viewport
from ..scene import cache, tints
from ..scene.clip_time import is_still
from ..scene.scene_object import SceneObject, why_none

LEVELS = "▁▂▃▄▅▆▇█"
"""Characters for the bars of the histogram, lowest first."""


def _bars(counts: list[int]) -> str:
    """Return a histogram as one line of text. Heights are square roots, because most Gaussians have a score near 0."""
    highest = max(counts, default=0) or 1
    return "".join(LEVELS[round((count / highest) ** 0.5 * (len(LEVELS) - 1))] for count in counts)


EXAMPLE, EXAMPLE_OF_STILL = "Or: select what moves", "Or: make everything warmer"
"""Placeholders of the field for answers."""
WITHOUT = "No scene yet. Drop a .f4x file into the viewport, or make a scene of a video."
BALLS = "F12 draws balls: Blender's own engines know splats from 5.3 on. Show Picture chooses ours; Mesh > Composite merges both."
"""Of a file whose engine cannot draw Gaussians."""
CHOOSE_ONE = "There are several scenes. Select an object of one."
"""Text of the panel where it can show no scene."""
ROW_CHARACTERS = 24
"""Characters of an edit that its row shows in a sidebar as wide as Blender's own."""
CLOSE_BUTTON = 4
"""Characters that a button beside lines takes."""
ANSWER_LINES = 1
"""Lines kept free for an answer, so that it moves no button under the mouse."""


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


class F4X_OT_dismiss_notice(Reporting, bpy.types.Operator):  # noqa: N801
    """Remove this notice from the panel."""

    bl_idname, bl_label = "f4x.dismiss_notice", "Dismiss Notice"

    def execute(self, context):
        """Forget the notice of the active scene."""
        if (scene_object := SceneObject.of(context.object)) is not None:
            scene_object.state.notice = ""
        return {"FINISHED"}


def _examples(scene_object: SceneObject) -> tuple[str, str]:
    """Return what the empty fields for words and sentences show: something that this scene can find."""
    still = is_still(scene_object.root)
    try:
        words = cache.answers_of(scene_object.base)
    except F4xError:  # its file is missing
        words = []
    if words:
        return ", ".join(words[:2]), f"make the {words[0]} red{'' if still else ' from second 2'}"
    word = "everything" if still else "what moves"
    return word, f"make {word} red"


def _touched(context: bpy.types.Context, scene_object: SceneObject) -> str:
    """Draw the changes of points by other tools that no edit holds; nothing while the scene plays."""
    return "" if context.screen.is_animation_playing else point_edits.summary(scene_object)


class F4X_PT_scene(bpy.types.Panel):  # noqa: N801
    """The active scene, and whether its edits are saved in its file."""

    bl_label = "Scene"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", CATEGORY

    def draw_header_preset(self, context):
        """Draw the link to the documentation."""
        self.layout.operator("f4x.documentation", text="", icon="HELP", emboss=False)

    def draw(self, context):
        """Draw the scene, or what to do without one."""
        layout = self.layout
        scene_object = SceneObject.of(context.object)
        if scene_object is None:
            several = bool(SceneObject.among(context.scene.objects))
            line = CHOOSE_ONE if several else WITHOUT
            draw_lines(layout, context, why_none(context.object) or line, "INFO")
            column = layout.column(align=True)
            column.operator("f4x.import_scene", text="Import Scene…", icon="IMPORT")
            column.operator("f4x.fit_clip", text="Fit Video…", icon="FILE_MOVIE")
            column.operator("f4x.documentation", icon="HELP")
            return
        row = layout.row(align=True)
        row.label(text=scene_object.name, icon="OUTLINER_OB_POINTCLOUD")
        row.prop(scene_object.state, "show_believed", text="", icon="VIEW_CAMERA")
        if tints.are_there(scene_object.clouds):
            layout.prop(scene_object.state, "colors_over_time")
        if context.scene.render.engine != ENGINE and not draws_splats():
            draw_lines(layout, context, BALLS, "INFO")
        if not viewport.shows_picture(context.scene, context.space_data):
            layout.operator("f4x.show_picture", icon="SHADING_RENDERED")
        if not scene_object.path.exists():
            layout.operator("f4x.find_scene", text="Find Scene File…", icon="ERROR")
        if _touched(context, scene_object):
            draw_lines(layout, context, _touched(context, scene_object), "ERROR")
            row = layout.row(align=True)
            row.operator("f4x.take_over_points")
            row.operator("f4x.put_back_points", text="", icon="LOOP_BACK")
        camera = clip_camera(scene_object.root)
        if camera is not None and context.scene.camera != camera:
            layout.operator("f4x.set_up_render", icon="OUTLINER_OB_CAMERA")
        if scene_object.state.notice:
            row = layout.row()
            draw_lines(row, context, scene_object.state.notice, "ERROR", beside=CLOSE_BUTTON)
            row.operator("f4x.dismiss_notice", text="", icon="X", emboss=False)


class F4X_PT_ask(Section, bpy.types.Panel):  # noqa: N801
    """Selection by words, a click or a gesture."""

    bl_label = "Select"

    def draw(self, context):
        """Draw the words, the tools and the threshold."""
        layout, scene_object = self.layout, SceneObject.of(context.object)
        state, (words, _) = scene_object.state, _examples(scene_object)
        row = layout.row(align=True)
        row.prop(context.window_manager.f4x, "text", text="", icon="VIEWZOOM", placeholder=words)
        row.operator("f4x.query_text", text="", icon="PLAY")
        draw_lines(layout, context, state.found, "INFO")
        row = layout.row(align=True)
        row.prop(state, "mode", expand=True, icon_only=True)
        row.separator()
        row.operator("f4x.query_point", icon="EYEDROPPER")
        row.operator("f4x.query_box")
        row = layout.row(align=True)
        for tool in TOOLS:
            row.operator("wm.tool_set_by_id", text=tool.bl_label.rpartition(" ")[2]).name = tool.bl_idname
        row.prop(state, "through", text="", icon="XRAY")
        row.prop(state, "whole", text="", icon="OBJECT_DATA")
        column = layout.column(align=True)
        if not draw_search(column, "SELECT"):  # the bars are there without scores too: buttons that move are missed
            row = column.row()
            row.active, row.alignment = state.live, "CENTER"
            row.label(text=_bars(json.loads(state.histogram or f"[{', '.join('0' * marking.BARS)}]")))
        row = column.row()
        row.active = state.live
        row.prop(state, "threshold", slider=True)
        row = layout.row()
        selected, total = listing.last_counts(scene_object)
        row.label(text=f"{selected:,} of {total:,} selected", icon="RESTRICT_SELECT_OFF")
        row.prop(state, "show_score", text="", icon="COLORSET_01_VEC", toggle=True)


class F4X_PT_selection(Section, bpy.types.Panel):  # noqa: N801
    """Tools for the selection."""

    bl_label = "Refine"
    bl_parent_id = "F4X_PT_ask"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender

    def draw(self, context):
        """Draw buttons that change, hide and name the selection."""
        layout, state = self.layout, SceneObject.of(context.object).state
        layout.prop(context.window_manager.f4x, "negatives", text="", icon="REMOVE", placeholder="but not …")
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


class F4X_PT_change(Section, bpy.types.Panel):  # noqa: N801
    """A sentence, and buttons, that edit the selection."""

    bl_label = "Edit"

    def draw(self, context):
        """Draw the sentence, then buttons for color, visibility, place and time."""
        layout, scene_object = self.layout, SceneObject.of(context.object)
        state, (_, sentence) = scene_object.state, _examples(scene_object)
        row = layout.row(align=True)
        row.prop(context.window_manager.f4x, "sentence", text="", icon="CONSOLE", placeholder=sentence)
        row.operator("f4x.plan", text="", icon="PLAY").readings = 1
        searching = draw_search(layout, "EDIT")
        if state.readings:
            self._draw_readings(layout, context, state)
        if not searching and (state.answer or not state.readings):
            example = EXAMPLE_OF_STILL if is_still(state.id_data) else EXAMPLE
            draw_lines(layout, context, state.answer or example, "INFO", space=(ANSWER_LINES, 100))
        if state.slower:
            layout.operator("f4x.slow_clip", icon="TIME").speed = state.slower
        if state.instead:
            layout.operator("f4x.plan", text="Read It So", icon="CHECKMARK").sentence = state.instead
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
        row = column.row(align=True)
        row.operator("f4x.remove", icon="TRASH")
        row.operator("f4x.extract")
        row.operator("f4x.restore", icon="LOOP_BACK")
        grid = column.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
        row = grid.row(align=True)
        row.operator("f4x.transform", text="Move…", icon="ORIENTATION_GLOBAL")
        row.operator("f4x.edit_gizmo", text="", icon="GIZMO").edit_id = 0
        grid.operator("f4x.duplicate", text="Duplicate…", icon="DUPLICATE")
        if not is_still(state.id_data):
            grid.operator("f4x.freeze", text="Freeze…", icon="PAUSE")
            grid.operator("f4x.retime", text="Retime…", icon="TIME")

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
                draw_lines(box, context, reading.line_at(SceneObject.of(context.object).frame), "INFO")
        row = box.row(align=True)
        row.operator("f4x.apply_plan", icon="CHECKMARK")
        shown = context.window_manager.f4x
        row.prop(shown, "preview", text="", icon="HIDE_OFF" if shown.preview else "HIDE_ON")
        row.operator("f4x.drop_plan", text="", icon="X")
        if len(state.readings) == 1:
            again = layout.operator("f4x.plan", text="Other Readings", icon="VIEWZOOM")
            again.readings = planning.READINGS


class F4X_PT_place(Section, bpy.types.Panel):  # noqa: N801
    """Tools that clean a scene, and put it where it belongs."""

    bl_label = "Clean and Place"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender
    bl_order = 80

    def draw(self, context):
        """Draw the tools."""
        layout = self.layout
        column = layout.column(align=True)
        column.operator("f4x.remove_floaters", icon="PARTICLES")
        if cleanup.box_of(SceneObject.of(context.object)) is None:
            column.operator("f4x.add_crop_box", icon="CUBE")
        else:
            row = column.row(align=True)
            row.operator("f4x.crop", text="Keep Inside", icon="CUBE").keep = "INSIDE"
            row.operator("f4x.crop", text="Remove Inside").keep = "OUTSIDE"
        column = layout.column(align=True)
        column.operator("f4x.align_floor", icon="GRID")
        row = column.row(align=True)
        row.operator("f4x.align_points")
        row.operator("f4x.scale_length")


class F4X_PT_history(Section, bpy.types.Panel):  # noqa: N801
    """The edit stack, and whether it is saved in the scene file."""

    bl_label = "Edits"

    def draw(self, context):
        """Draw the list, with buttons to move, delete and save edits, and the fields of the one that is picked."""
        layout, scene_object = self.layout, SceneObject.of(context.object)
        state = scene_object.state
        row = layout.row()
        row.template_list("F4X_UL_history", "", state, "history", state, "history_index", rows=2)
        column = row.column(align=True)
        if 0 <= state.history_index < len(state.history):
            item = state.history[state.history_index]
            for how, icon in (("UP", "TRIA_UP"), ("DOWN", "TRIA_DOWN")):
                button = column.operator("f4x.history", text="", icon=icon)
                button.how, button.edit_id = how, item.edit_id
            if len(item.name) > ROW_CHARACTERS:
                draw_lines(layout, context, item.name)
        column.operator("f4x.history", text="", icon="TRASH").how = "CLEAR"
        self._draw_saving(layout, context, scene_object)
        draw_fields(layout, scene_object)
        draw_lines(layout, context, state.uncovered, "INFO")

    def _draw_saving(self, layout, context, scene_object):
        """Draw the buttons that save the edits and bake them, where there is something to save."""
        if not scene_object.holds_edits:
            layout.operator("f4x.save_as", text="Save As Scene…", icon="FILE_TICK")
            return
        saved, touched = scene_object.is_saved, bool(_touched(context, scene_object))
        if scene_object.state.history or not saved or touched:
            column = layout.column(align=True)
            row = column.row(align=True)
            text = "Save Edits to Scene" if saved and touched else scene_object.saving
            row.operator("f4x.save_edits", text=text, icon="FILE_TICK")
            row.active = touched or not saved
            column.operator("f4x.bake_edits", text="Bake…", icon="FILE_NEW")
        runner.draw_running(layout, context, baking.TITLE)


CLASSES = (
    F4X_UL_names,
    F4X_UL_history,
    F4X_PT_scene,
    F4X_PT_ask,
    F4X_PT_selection,
    F4X_PT_change,
    F4X_PT_history,
    F4X_PT_place,
    F4X_OT_dismiss_notice,
)
