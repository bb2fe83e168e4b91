"""Operators that select by a gesture in a viewport - a box, a brush stroke, a lasso, a sphere - and the tools that call them.

Coordinates are those of Blender's own gestures: pixels of the viewport from its lower left corner. Without a window they are
pixels of the picture that the scene's camera renders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
import numpy as np
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, FloatVectorProperty
from bpy_extras import view3d_utils
from mathutils import Vector

from ...f4x_core.errors import F4xError
from ...f4x_core.query.gesture import select_by_gesture, select_by_sphere, select_thing
from ...f4x_core.query.neighbourhood import meeting
from ...f4x_core.query.selection import Selection
from ...f4x_core.query.shapes import Polygon, Rectangle, Shape, Stroke
from ..common.axes import Eye, camera_eye, eye
from ..common.outline import Outline
from ..edits import marking
from ..scene.scene_object import SceneObject
from .base import SceneOperator, require_viewport

ROUND = 48
"""Corners of a drawn circle."""
WIDER = 1.25
"""Factor of the brush's radius for a step of the mouse wheel."""
WHEEL = {"WHEELUPMOUSE", "WHEELDOWNMOUSE"}
NAVIGATION = {"MIDDLEMOUSE", *WHEEL}

Corner = tuple[float, float]


def _circle(centre: Corner, radius: float) -> list[Corner]:
    angles = [2 * math.pi * i / ROUND for i in range(ROUND)]
    return [(centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)) for angle in angles]


def _eye(context: bpy.types.Context) -> Eye:
    """Return the viewport's view, else that of the scene's camera; F4xError without either."""
    region, view, scene = context.region, context.region_data, context.scene
    if region is not None and view is not None:
        return eye(np.array(view.window_matrix), np.array(view.view_matrix), region.width, region.height)
    if scene.camera is None:
        raise F4xError("There is neither a viewport nor a camera to look through; add a camera.")
    render = scene.render
    width, height = (side * render.resolution_percentage // 100 for side in (render.resolution_x, render.resolution_y))
    return camera_eye(scene.camera, scene, context.evaluated_depsgraph_get(), width, height)


class _Gesture(SceneOperator):
    """Base of operators that follow a dragged mouse, and select what its way marks when the button is released."""

    hint = ""
    mode: EnumProperty(name="Mode", items=marking.MODES, default="SET", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def take(self, corners: list[Corner]) -> None:
        """Set the operator's properties from the way of the mouse so far, at least one place."""
        raise NotImplementedError

    def lines(self) -> list[Sequence[Corner]]:
        """Return the lines that are drawn while the mouse moves."""
        raise NotImplementedError

    def select(self, scene_object: SceneObject, seen: Eye) -> Selection:
        """Return the Gaussians that the properties select."""
        raise NotImplementedError

    def wheel(self, scene_object: SceneObject, up: bool) -> bool:
        """Answer the mouse wheel; whether the gesture uses it."""
        return False

    def act(self, context, scene_object):
        """Select, combined with what was selected before."""
        marking.ask(scene_object, self.select(scene_object, _eye(context)), self.mode)
        state = scene_object.state
        self.report({"INFO"}, f"{state.selected:,} of {state.total:,} Gaussians")

    def invoke(self, context, event):
        """Follow the mouse: from where its button was pressed, else from where that will be."""
        require_viewport(context)
        region = next(region for region in context.area.regions if region.type == "WINDOW")
        self._region, self._outline, self._way = region, Outline(region), []
        if event.type == "LEFTMOUSE" and event.value == "CLICK_DRAG":  # the mouse has moved since it was pressed
            self._go(context, event.mouse_prev_press_x, event.mouse_prev_press_y)
        elif event.type == "LEFTMOUSE" and event.value == "PRESS":
            self._go(context, event.mouse_x, event.mouse_y)
        context.workspace.status_text_set(f"{self.hint} Right click or Esc: cancel.")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Draw the gesture until the button is released."""
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.let_go(context)
            return {"CANCELLED"}
        if event.type in WHEEL and self.wheel(SceneObject.of(context.object), event.type == "WHEELUPMOUSE"):
            self._draw(context)
            return {"RUNNING_MODAL"}
        if (event.type == "LEFTMOUSE" and event.value == "PRESS") or (self._way and event.type == "MOUSEMOVE"):
            self._go(context, event.mouse_x, event.mouse_y)
        elif self._way and event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self.let_go(context)
            with context.temp_override(region=self._region):
                return self.execute(context)
        return {"PASS_THROUGH"} if event.type in NAVIGATION and not self._way else {"RUNNING_MODAL"}

    def _go(self, context, x: int, y: int) -> None:
        self._way.append((float(x - self._region.x), float(y - self._region.y)))
        with context.temp_override(region=self._region):
            self.take(self._way)
        self._draw(context)

    def _draw(self, context) -> None:
        self._outline.lines = self.lines() if self._way else []
        context.area.tag_redraw()

    def let_go(self, context) -> None:
        """Take down what was drawn."""
        self._outline.end()
        context.workspace.status_text_set(None)
        context.area.tag_redraw()


class _Drawn(_Gesture):
    """Base of gestures that draw a shape over the view."""

    through: BoolProperty(  # type: ignore[valid-type]
        name="Through", description="Select also what is hidden behind other Gaussians"
    )
    whole: BoolProperty(  # type: ignore[valid-type]
        name="Whole Thing", description="Select the thing that the gesture marks, all of it and at all times"
    )
    around = True

    def shape(self, scene_object: SceneObject, flip) -> Shape:
        """Return the shape; `flip` turns places in the viewport to pixels of the core, whose y axis points down."""
        raise NotImplementedError

    def select(self, scene_object, seen):
        """Return the selection of the Gaussians in the shape, or of the thing that they show."""
        for name in ("through", "whole"):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(scene_object.state, name))
        shape = self.shape(scene_object, lambda at: (at[0], seen.camera.height - at[1]))
        scene = scene_object.shown.scene
        found = select_by_gesture(scene, scene_object.view(seen), shape, through=self.through)
        if not self.whole:
            return found
        marking.tell_of_features(scene_object)
        return select_thing(scene, found, scene.cameras.frame_at(scene_object.frame), around=self.around)


class F4X_OT_select_box(_Drawn, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Drag a box to select the Gaussians in it."""

    bl_idname, bl_label = "f4x.select_box", "Select Gaussians: Box"
    hint = "Drag a box."

    box: FloatVectorProperty(name="Box", description="Left, bottom, right, top in pixels", size=4)  # type: ignore[valid-type]

    def take(self, corners):
        """Set the box from the first place to the last."""
        self.box = (*corners[0], *corners[-1])

    def lines(self):
        """Return the sides of the box."""
        left, bottom, right, top = self.box
        return [[(left, bottom), (right, bottom), (right, top), (left, top)]]

    def shape(self, scene_object, flip):
        """Return the box as a shape."""
        return Rectangle(flip(self.box[:2]), flip(self.box[2:]))


class _Path(_Drawn):
    """Base of gestures that use the whole way of the mouse."""

    path: CollectionProperty(name="Path", type=bpy.types.OperatorMousePath, options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def take(self, corners):
        """Add the last place."""
        self.path.add().loc = corners[-1]

    def _places(self) -> list[Corner]:
        return [tuple(each.loc) for each in self.path]


class F4X_OT_select_lasso(_Path, bpy.types.Operator):  # noqa: N801
    """Draw around Gaussians to select them."""

    bl_idname, bl_label = "f4x.select_lasso", "Select Gaussians: Lasso"
    hint = "Draw around what to select."

    def lines(self):
        """Return the drawn line, closed."""
        return [self._places()]

    def shape(self, scene_object, flip):
        """Return the polygon that the line encloses."""
        return Polygon([flip(place) for place in self._places()])


class F4X_OT_select_brush(_Path, bpy.types.Operator):  # noqa: N801
    """Paint over Gaussians to select them. The mouse wheel changes the radius."""

    bl_idname, bl_label = "f4x.select_brush", "Select Gaussians: Brush"
    hint = "Paint over what to select. Wheel: radius."
    around = False

    radius: FloatProperty(name="Radius", description="Radius of the brush in pixels", min=1.0, default=25.0)  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Start with the radius of the tool."""
        self.radius = SceneObject.of(context.object).state.brush
        return super().invoke(context, event)

    def wheel(self, scene_object, up):
        """Make the brush wider or narrower, also for the next strokes."""
        self.radius = scene_object.state.brush = self.radius * (WIDER if up else 1 / WIDER)
        return True

    def lines(self):
        """Return the lines to draw: the path of the mouse, and the circle of the brush at its end."""
        places = self._places()
        return [[*places, *places[::-1]], _circle(places[-1], self.radius)]

    def shape(self, scene_object, flip):
        """Return the stroke of the brush."""
        return Stroke([flip(place) for place in self._places()], self.radius)


class F4X_OT_select_sphere(_Gesture, bpy.types.Operator):  # noqa: N801
    """Drag from a place on an object to select the Gaussians in a sphere around it. Handles move and resize the sphere."""

    bl_idname, bl_label = "f4x.select_sphere", "Select Gaussians: Sphere"
    hint = "Drag from the center of a sphere."

    centre: FloatVectorProperty(name="Center", description="In Blender's world", subtype="XYZ")  # type: ignore[valid-type]
    radius: FloatProperty(name="Radius", description="In Blender's units", min=0.0, subtype="DISTANCE")  # type: ignore[valid-type]

    def take(self, corners):
        """Put the centre on what is under the first place, and make the radius reach the last one in the centre's depth."""
        context = bpy.context
        if len(corners) == 1:
            self.centre = place_under(context, SceneObject.of(context.object), corners[0])
        at = view3d_utils.region_2d_to_location_3d(
            context.region, context.region_data, corners[-1], Vector(self.centre)
        )
        self.radius = (at - Vector(self.centre)).length
        self._ends = corners[0], corners[-1]

    def lines(self):
        """Return the circle that the sphere looks like."""
        return [_circle(self._ends[0], math.dist(*self._ends))]

    def select(self, scene_object, seen):
        """Return the selection of the Gaussians in the sphere."""
        return select_by_sphere(scene_object.shown.scene, scene_object.view(seen), tuple(self.centre), self.radius)

    def act(self, context, scene_object):
        """Select, and leave the sphere with its handles."""
        super().act(context, scene_object)
        scene_object.state.sphere, scene_object.state.sphere_radius = self.centre, self.radius


def place_under(context: bpy.types.Context, scene_object: SceneObject, at: Corner) -> Vector:
    """Return the point of the scene under a place of the viewport, in Blender's world. Raises F4xError where there is none."""
    region, view, to_world = context.region, context.region_data, scene_object.root.matrix_world
    to_scene = to_world.inverted()
    origin = to_scene @ view3d_utils.region_2d_to_origin_3d(region, view, at)
    direction = (to_scene.to_3x3() @ view3d_utils.region_2d_to_vector_3d(region, view, at)).normalized()
    posed = scene_object.shown.scene.posed(scene_object.frame)
    there = meeting(posed, np.array(origin), np.array(direction))
    if there is None:
        raise F4xError("There is nothing under the mouse; start on an object of the scene.")
    return to_world @ Vector(there)


def _keys(operator: str, value: str) -> tuple:
    """Return the keymap of a tool, in which Blender's own modifiers choose the mode."""
    held = {"SET": {}, "ADD": {"shift": True}, "SUBTRACT": {"ctrl": True}, "INTERSECT": {"shift": True, "ctrl": True}}
    return tuple(
        (operator, {"type": "LEFTMOUSE", "value": value, **keys}, {"properties": [("mode", mode)]})
        for mode, keys in held.items()
    )


class _Tool(bpy.types.WorkSpaceTool):
    """Base of the tools, which work in Object Mode."""

    bl_space_type, bl_context_mode = "VIEW_3D", "OBJECT"

    @classmethod
    def draw_settings(cls, context, layout, tool):
        """Draw settings in the header."""
        scene_object = SceneObject.of(context.object)
        for name in TOOL_SETTINGS[tool.idname] if scene_object is not None else ():
            layout.prop(scene_object.state, name)


class F4X_TL_box(_Tool):  # noqa: N801
    """Drag a box to select Gaussians."""

    bl_idname, bl_label, bl_icon = "f4x.box_tool", "Gaussians: Box", "ops.generic.select_box"
    bl_keymap = _keys("f4x.select_box", "CLICK_DRAG")


class F4X_TL_brush(_Tool):  # noqa: N801
    """Paint over Gaussians to select them."""

    bl_idname, bl_label, bl_icon = "f4x.brush_tool", "Gaussians: Brush", "ops.generic.select_circle"
    bl_keymap = _keys("f4x.select_brush", "PRESS")


class F4X_TL_lasso(_Tool):  # noqa: N801
    """Draw around Gaussians to select them."""

    bl_idname, bl_label, bl_icon = "f4x.lasso_tool", "Gaussians: Lasso", "ops.generic.select_lasso"
    bl_keymap = _keys("f4x.select_lasso", "CLICK_DRAG")


class F4X_TL_sphere(_Tool):  # noqa: N801
    """Drag a sphere to select the Gaussians in it."""

    bl_idname, bl_label, bl_icon = "f4x.sphere_tool", "Gaussians: Sphere", "ops.gpencil.primitive_circle"
    bl_keymap = _keys("f4x.select_sphere", "CLICK_DRAG")
    bl_widget = "F4X_GGT_sphere"


TOOLS = (F4X_TL_box, F4X_TL_brush, F4X_TL_lasso, F4X_TL_sphere)
TOOL_SETTINGS = {
    F4X_TL_box.bl_idname: ("through", "whole"),
    F4X_TL_brush.bl_idname: ("through", "whole", "brush"),
    F4X_TL_lasso.bl_idname: ("through", "whole"),
    F4X_TL_sphere.bl_idname: ("sphere_radius",),
}
"""Tool -> properties of the sidebar that its header shows."""
CLASSES = (F4X_OT_select_box, F4X_OT_select_lasso, F4X_OT_select_brush, F4X_OT_select_sphere)


def register() -> None:
    """Add the tools to the toolbar, as one group below Blender's own."""
    for number, tool in enumerate(TOOLS):
        after = {TOOLS[number - 1].bl_idname} if number else None
        bpy.utils.register_tool(tool, after=after, separator=not number, group=not number)


def unregister() -> None:
    """Undo `register`."""
    for tool in reversed(TOOLS):
        bpy.utils.unregister_tool(tool)
