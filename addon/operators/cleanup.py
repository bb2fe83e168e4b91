"""Cleaning a scene by edits: what floats in the air, and what lies in or outside a crop box that is placed in the viewport."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty
from mathutils import Matrix

from ...f4x_core.edit.operations import NOTHING_ALONG, Delete
from ...f4x_core.edit.selects import Ids
from ...f4x_core.errors import F4xError
from ...f4x_core.query.floaters import floater_scores
from ...f4x_core.query.not_deleted import not_deleted
from ...f4x_core.query.volumes import inside_cube
from ..common.point_cloud import select_only
from ..edits import display
from ..scene.scene_object import SceneObject
from .base import DescribedChoice, SceneOperator

BOX = "f4x_crop_box"
"""Property of an empty that is a crop box: the id of the edit that it made last, 0 before."""
BULK = (5, 95)
"""Percentiles of the positions that a new crop box spans."""
MARGIN = 1.2
"""Size of a new crop box by that span."""


def box_of(scene_object: SceneObject) -> bpy.types.Object | None:
    """Return the crop box that is active, else one of the scene."""
    active = bpy.context.object
    boxes = [item for item in scene_object.below if BOX in item]
    return active if active in boxes else next(iter(boxes), None)


class F4X_OT_remove_floaters(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Remove Gaussians that nothing holds up: specks in the air, small clumps, faint haze, and what lies far away alone."""

    bl_idname, bl_label = "f4x.remove_floaters", "Remove Floaters"

    strength: FloatProperty(  # type: ignore[valid-type]
        name="Strength",
        description="More removes more doubtful ones",
        default=0.5,
        min=0.05,
        max=0.95,
        subtype="FACTOR",
    )

    def act(self, context, scene_object):
        """Append a removal of those whose score is above 1 - strength."""
        scene = scene_object.shown.scene
        found = scene.ids[(floater_scores(scene) >= 1 - self.strength) & not_deleted(scene)]
        if not len(found):
            raise F4xError(
                f"{scene_object.name} has no floaters at this strength; raise it under Adjust Last Operation."
            )
        ids = Ids.of(found)
        scene_object.append(Delete(Ids(ids.ids, ids.first, ids.packed, "the floaters"), along=NOTHING_ALONG))
        display.refresh(scene_object)
        self.report({"INFO"}, f"Removed {len(found):,} of {len(scene.ids):,} Gaussians")


class F4X_OT_add_crop_box(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Add a box around most of the scene. Move, rotate and scale it, then press Keep Inside or Remove Inside."""

    bl_idname, bl_label = "f4x.add_crop_box", "Add Crop Box"

    def act(self, context, scene_object):
        """Add a cube-shaped empty below the root, and make it active."""
        root, scene = scene_object.root, scene_object.shown.scene
        matrix = np.array(root.matrix_world)
        means = scene.posed(scene_object.frame).means @ matrix[:3, :3].T + matrix[:3, 3]
        low, high = np.percentile(means, BULK, axis=0) if len(means) else (-np.ones(3), np.ones(3))
        box = bpy.data.objects.new(f"{root.name} crop box", None)
        box.empty_display_type, box.empty_display_size = "CUBE", 1.0
        box[BOX] = 0
        root.users_collection[0].objects.link(box)
        box.parent, box.matrix_parent_inverse = root, root.matrix_world.inverted_safe()  # its numbers are Blender's
        half = np.maximum((high - low) / 2 * MARGIN, 1e-3)
        box.matrix_basis = Matrix.LocRotScale(((low + high) / 2).tolist(), None, half.tolist())
        select_only(box)


class F4X_OT_crop(DescribedChoice, SceneOperator, bpy.types.Operator):  # noqa: N801
    """Remove what is outside or inside the crop box, as an edit. Pressed again, the box replaces its own edit."""

    bl_idname, bl_label = "f4x.crop", "Crop"
    choice = "keep"

    keep: EnumProperty(  # type: ignore[valid-type]
        name="Keep",
        items=(
            ("INSIDE", "Keep Inside", "Remove everything that is never in the box"),
            ("OUTSIDE", "Remove Inside", "Remove everything that is in the box at some time of the clip"),
        ),
    )

    def act(self, context, scene_object):
        """Append a removal, in place of what this box removed before."""
        box = box_of(scene_object)
        if box is None:
            raise F4xError(f"{scene_object.name} has no crop box; press Add Crop Box first.")
        before, sentence = scene_object.stack, f"by {box.name}"
        if any(edit.id == box[BOX] and edit.sentence == sentence for edit in before.edits):
            scene_object.set_stack(before.remove(box[BOX]))
        try:
            scene = scene_object.edited
            context.view_layer.update()
            cube_from_scene = np.array(box.matrix_world.inverted_safe() @ scene_object.root.matrix_world)
            inside = inside_cube(scene, cube_from_scene)
            gone = (inside if self.keep == "OUTSIDE" else ~inside) & not_deleted(scene)
            if not gone.any() or gone[not_deleted(scene)].all():
                what = "nothing" if not gone.any() else "everything"
                raise F4xError(f"That would remove {what}; move or scale {box.name} first.")
            where = "inside" if self.keep == "OUTSIDE" else "outside"
            ids = Ids.of(scene.ids[gone])
            words = f"what is {where} the crop box"
            stack = scene_object.append(
                Delete(Ids(ids.ids, ids.first, ids.packed, words), along=NOTHING_ALONG), sentence=sentence
            )
        except F4xError:
            scene_object.set_stack(before)
            raise
        box[BOX] = stack.edits[-1].id
        display.refresh(scene_object)
        self.report({"INFO"}, f"Removed {int(gone.sum()):,} of {len(gone):,} Gaussians")


CLASSES = (F4X_OT_remove_floaters, F4X_OT_add_crop_box, F4X_OT_crop)
