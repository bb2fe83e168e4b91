"""Handles of the selecting sphere: one moves it, one resizes it, and three circles show it. The selection follows at once."""

from __future__ import annotations

import math
from itertools import pairwise

import bpy
from mathutils import Matrix, Vector

from ..scene.scene_object import SceneObject

ROUND = 64
"""Sides of a drawn circle."""
COLOUR, HIGHLIGHT = (1.0, 0.6, 0.1), (1.0, 0.8, 0.4)


def _circles() -> list[tuple[float, float, float]]:
    """Return the ends of the lines of three circles of radius 1, around each axis."""
    angles = [2 * math.pi * i / ROUND for i in range(ROUND + 1)]
    flat = [(math.cos(angle), math.sin(angle), 0.0) for angle in angles]
    lines = [end for pair in pairwise(flat) for end in pair]
    return [corner[axis:] + corner[:axis] for axis in range(3) for corner in lines]


class F4X_GT_sphere(bpy.types.Gizmo):  # noqa: N801 - Blender wants this form
    """The sphere as three circles."""

    bl_idname = "F4X_GT_sphere"

    def setup(self):
        """Make the lines once."""
        self.lines = self.new_custom_shape("LINES", _circles())

    def draw(self, context):
        """Draw them."""
        self.draw_custom_shape(self.lines)


class F4X_GGT_sphere(bpy.types.GizmoGroup):  # noqa: N801
    """Shown by the tool that selects by a sphere, once there is one."""

    bl_idname, bl_label = "F4X_GGT_sphere", "Selecting Sphere"
    bl_space_type, bl_region_type = "VIEW_3D", "WINDOW"
    bl_options = {"3D"}  # noqa: RUF012 - read by Blender

    @classmethod
    def poll(cls, context):
        """Return True where the scene has such a sphere."""
        scene_object = SceneObject.of(context.object)
        return scene_object is not None and scene_object.state.sphere_radius > 0

    def setup(self, context):
        """Make the circles and the handles."""
        self.sphere = self.gizmos.new(F4X_GT_sphere.bl_idname)
        self.sphere.use_draw_scale, self.sphere.hide_select = False, True
        self.centre, self.size = self.gizmos.new("GIZMO_GT_move_3d"), self.gizmos.new("GIZMO_GT_arrow_3d")
        self.centre.draw_options, self.centre.scale_basis = {"FILL_SELECT", "ALIGN_VIEW"}, 0.2
        self.size.draw_style, self.size.length = "BOX", 0.0
        for handle in (self.sphere, self.centre, self.size):
            handle.color, handle.alpha, handle.color_highlight, handle.alpha_highlight = COLOUR, 0.8, HIGHLIGHT, 1.0

    def refresh(self, context):
        """Bind the handles to the sphere of the active scene."""
        state = SceneObject.of(context.object).state
        self.centre.target_set_prop("offset", state, "sphere")
        self.size.target_set_prop("offset", state, "sphere_radius")

    def draw_prepare(self, context):
        """Put what is drawn where the sphere is; it is resized to the right of the view."""
        scene_object = SceneObject.of(context.object)
        if scene_object is None:
            return
        centre, radius = Vector(scene_object.state.sphere), scene_object.state.sphere_radius
        turn = context.region_data.view_matrix.to_3x3().inverted().to_4x4()
        self.sphere.matrix_basis = Matrix.Translation(centre) @ Matrix.Scale(radius, 4)
        self.size.matrix_basis = Matrix.Translation(centre) @ turn @ Matrix.Rotation(math.pi / 2, 4, "Y")


CLASSES = (F4X_GT_sphere, F4X_GGT_sphere)
