"""Putting a scene into Blender's world: its floor on Z = 0, a known length in meters. Only the root moves, no file changes."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.props import FloatProperty, FloatVectorProperty
from mathutils import Matrix, Vector

from ...f4x_core.errors import F4xError
from ...f4x_core.query.ground import LEANS, Plane, find_ground, leaning, plane_through
from ..io.import_scene import MIN_REACH
from ..render.viewport import see_to
from ..scene.scene_object import IN_METERS, SceneObject
from .base import SceneOperator, require_viewport
from .cleanup import BOX
from .gestures import place_under

REACH = 4.0
"""Distance that viewports see, by the scene's extent from Blender's origin."""


def _require_free(root: bpy.types.Object) -> None:
    """Raise F4xError where the root's place is keyed, so that another one would not last."""
    action = root.animation_data and root.animation_data.action
    if action or root.constraints:
        raise F4xError(
            f"{root.name} has keys or constraints of its own; remove them, or parent it to an empty and place that."
        )


def _place(context: bpy.types.Context, root: bpy.types.Object, change: Matrix) -> None:
    """Move the root by `change`, in Blender's world, and let viewports see as far as the scene goes."""
    root.matrix_world = change @ root.matrix_world
    context.view_layer.update()
    for box in (item for item in root.children if BOX in item):  # which went along, and keeps to Blender's axes
        placed = box.matrix_world.copy()
        box.matrix_parent_inverse = root.matrix_world.inverted_safe()
        box.matrix_world = placed
    see_to(REACH * _extent(SceneObject(root)))


def _extent(scene_object: SceneObject) -> float:
    """Return the distance from Blender's origin of the far end of the scene's bulk."""
    means = scene_object.base.static.means
    if not len(means):
        return MIN_REACH
    corners = np.percentile(means, (1, 99), axis=0)
    matrix = np.array(scene_object.root.matrix_world)
    return max(float(np.linalg.norm(matrix[:3, :3] @ corner + matrix[:3, 3])) for corner in corners)


def _is_in(region: bpy.types.Region, x: int, y: int) -> bool:
    """Return True if a pixel of the window is in a region."""
    return 0 <= x - region.x < region.width and 0 <= y - region.y < region.height


class _Clicks(SceneOperator):
    """Base of operators on places in the scene that are clicked in a viewport, or given by a script."""

    COUNT = 0
    hint = ""

    def invoke(self, context, event):
        """Wait for the clicks."""
        require_viewport(context)
        self._places: list[Vector] = []
        self._say(context)
        context.window.cursor_modal_set("CROSSHAIR")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Take a place with each click; everything that turns or moves the view goes on."""
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.let_go(context)
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        under = [region for region in context.area.regions if _is_in(region, event.mouse_x, event.mouse_y)]
        if [region.type for region in under] != ["WINDOW"]:  # the sidebar lies over the view
            return {"PASS_THROUGH"}
        at = event.mouse_x - under[0].x, event.mouse_y - under[0].y
        with context.temp_override(region=under[0]):
            self._places.append(place_under(bpy.context, SceneObject.of(context.object), at))
        if len(self._places) < self.COUNT:
            self._say(context)
            return {"RUNNING_MODAL"}
        self.let_go(context)
        self.take(self._places)
        return self.finish(context)

    def take(self, places: list[Vector]) -> None:
        """Set the operator's properties from the clicked places."""
        raise NotImplementedError

    def finish(self, context: bpy.types.Context) -> set[str]:
        """Do the work after the last click."""
        return self.execute(context)

    def let_go(self, context):
        """Give back the cursor and the status bar."""
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)

    def _say(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(
            f"{self.hint} {len(self._places) + 1} of {self.COUNT}. Right click or Esc: cancel."
        )


def _stand_on(context: bpy.types.Context, scene_object: SceneObject, floor: Plane) -> None:
    """Put `floor`, a plane in the scene's axes, on Blender's Z = 0 with its normal up."""
    root = scene_object.root
    _require_free(root)
    to_world = root.matrix_world
    foot = to_world @ Vector((floor.normal * floor.distance).tolist())
    normal = (to_world.to_3x3().inverted_safe().transposed() @ Vector(floor.normal.tolist())).normalized()
    turn = normal.rotation_difference(Vector((0, 0, 1))).to_matrix().to_4x4()
    about = Matrix.Translation(foot) @ turn @ Matrix.Translation(-foot)
    _place(context, root, Matrix.Translation((0, 0, -foot.z)) @ about)


class F4X_OT_align_floor(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Find the floor of the scene and put it on Blender's ground, Z = 0, with up along Z."""

    bl_idname, bl_label = "f4x.align_floor", "Align to Floor"

    def act(self, context, scene_object):
        """Place the root. The scene file stays as it is."""
        floor = find_ground(scene_object.base)
        _stand_on(context, scene_object, floor)
        lean = leaning(scene_object.base.cameras, floor)
        told = f", {lean:.0f}° off from level in the clip's pictures," if lean >= LEANS else ""
        self.report(
            {"INFO"}, f"The floor of {scene_object.name}{told} is on Z = 0 now; check it, or use Floor by 3 Points"
        )


class F4X_OT_align_points(_Clicks, bpy.types.Operator):  # noqa: N801
    """Click three places on the floor; they come to lie on Blender's ground, Z = 0, with up along Z."""

    bl_idname, bl_label = "f4x.align_points", "Floor by 3 Points"
    COUNT, hint = 3, "Click three places on the floor, far apart:"

    a: FloatVectorProperty(name="First", description="In Blender's world", subtype="XYZ")  # type: ignore[valid-type]
    b: FloatVectorProperty(name="Second", description="In Blender's world", subtype="XYZ")  # type: ignore[valid-type]
    c: FloatVectorProperty(name="Third", description="In Blender's world", subtype="XYZ")  # type: ignore[valid-type]

    def take(self, places):
        """Take the three points."""
        self.a, self.b, self.c = places

    def act(self, context, scene_object):
        """Place the root."""
        to_scene = scene_object.root.matrix_world.inverted_safe()
        points = np.array([to_scene @ Vector(place) for place in (self.a, self.b, self.c)])
        _stand_on(context, scene_object, plane_through(points, scene_object.base.cameras.centers[0]))
        self.report({"INFO"}, f"The three points of {scene_object.name} are on Z = 0 now")


class F4X_OT_scale_length(_Clicks, bpy.types.Operator):  # noqa: N801
    """Click two places whose distance you know, and enter it: the scene is scaled so that Blender's units are meters."""

    bl_idname, bl_label = "f4x.scale_length", "Scale to Length"
    COUNT, hint = 2, "Click two places whose distance is known:"

    a: FloatVectorProperty(
        name="First", description="In Blender's world", subtype="XYZ", options={"HIDDEN", "SKIP_SAVE"}
    )  # type: ignore[valid-type]
    b: FloatVectorProperty(
        name="Second", description="In Blender's world", subtype="XYZ", options={"HIDDEN", "SKIP_SAVE"}
    )  # type: ignore[valid-type]
    length: FloatProperty(name="Length", description="Their true distance", default=1.0, min=1e-4, subtype="DISTANCE")  # type: ignore[valid-type]

    def invoke(self, context, event):
        """Wait for the clicks, or with both places ask for the length."""
        if self.properties.is_property_set("a"):
            return context.window_manager.invoke_props_dialog(self)
        return super().invoke(context, event)

    def take(self, places):
        """Take the two ends, and their present distance as the length to change."""
        self.a, self.b = places
        self.length = (places[1] - places[0]).length

    def finish(self, context):
        """Ask for the length in an operator of its own: this one would go on taking the clicks on its dialog."""
        bpy.ops.f4x.scale_length("INVOKE_DEFAULT", a=self.a, b=self.b, length=self.length)
        return {"CANCELLED"}

    def act(self, context, scene_object):
        """Scale the root about the middle of the two places on the ground, so that what stands there stays there."""
        root = scene_object.root
        _require_free(root)
        a, b = Vector(self.a), Vector(self.b)
        measured = (b - a).length
        if measured < 1e-9:
            raise F4xError("The two places are the same; click two that are apart.")
        factor, middle = self.length / measured, (a + b) / 2
        middle.z = 0.0
        about = Matrix.Translation(middle)
        _place(context, root, about @ Matrix.Scale(factor, 4) @ about.inverted())
        root[IN_METERS] = True
        self.report(
            {"INFO"}, f"{scene_object.name} is {factor:.4g} times as large; {measured:.4g} became {self.length:.4g}"
        )


CLASSES = (F4X_OT_align_floor, F4X_OT_align_points, F4X_OT_scale_length)
