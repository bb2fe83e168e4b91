"""The selection, drawn over viewports: pink points at the Gaussians' centres, in no render."""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader

from ..common.point_cloud import read_attribute
from ..rig.native_motion import carried_places
from ..scene.scene_object import PREVIEW, SELECTED, SceneObject

COLOUR = (1.0, 0.05, 0.6, 0.3)
"""Pink: rare in pictures, unlike the orange in which Blender outlines objects; the points' own color shows through."""
SIZE = 2.0
"""Pixels of a point at a scale of 1."""

_batches: dict[int, gpu.types.GPUBatch | None] = {}  # session_uid of a cloud -> its selected points
_handle = None


def _draw() -> None:
    """Draw the selected points of every cloud, made anew only where something has changed."""
    context = bpy.context
    if context.mode != "OBJECT" or not context.space_data.overlay.show_overlays:
        return
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    depsgraph = context.evaluated_depsgraph_get()
    # a preview is to be looked at: nothing is drawn over it
    for scene_object in [each for each in SceneObject.among(context.scene.objects) if PREVIEW not in each.root]:
        for cloud in scene_object.clouds:
            if not cloud.visible_get():
                continue
            if cloud.session_uid not in _batches:
                _batches[cloud.session_uid] = _batch(cloud, cloud.evaluated_get(depsgraph).data, shader)
            batch = _batches[cloud.session_uid]
            if batch is None:
                continue
            gpu.state.blend_set("ALPHA")
            gpu.state.point_size_set(SIZE * context.preferences.system.ui_scale)
            with gpu.matrix.push_pop():
                gpu.matrix.multiply_matrix(cloud.matrix_world)
                shader.uniform_float("color", COLOUR)
                batch.draw(shader)
            gpu.state.blend_set("NONE")


def _batch(
    cloud: bpy.types.Object, data: bpy.types.PointCloud, shader: gpu.types.GPUShader
) -> gpu.types.GPUBatch | None:
    """Return the selected points of an evaluated cloud; None where there are none."""
    chosen = read_attribute(data, SELECTED)
    if chosen is None or not chosen.any():
        return None
    return batch_for_shader(shader, "POINTS", {"pos": carried_places(cloud, data)[np.flatnonzero(chosen)]})


@persistent
def _changed(*_) -> None:
    _batches.clear()


HANDLERS = dict.fromkeys(
    ("depsgraph_update_post", "frame_change_post", "undo_post", "redo_post", "load_post"), _changed
)


def register() -> None:
    """Start drawing."""
    global _handle
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    """Undo `register`."""
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None
    _batches.clear()
