"""The selection, drawn over viewports: pink points at the Gaussians' centres, in no render."""

from __future__ import annotations

from functools import cache

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader

from ...f4x_core.scene.color import linear_from_srgb
from ..common.point_cloud import read_attribute
from ..render import viewport_gpu
from ..render.viewport_gpu import SurfaceDepths, interface, shader_info
from ..rig.native_motion import carried_places
from ..scene.scene_object import PREVIEW, SELECTED, SceneObject

COLOUR = (1.0, 0.05, 0.6, 0.3)
"""Pink, in sRGB: rare in pictures, unlike the orange in which Blender outlines objects; the points' own color shows through."""
FAINTEST = 1 / 255
"""Smallest opacity that the engine draws."""
SIZE = 2.0
"""Pixels of a point at a scale of 1."""

VERTEX = """
void main()
{
  gl_Position = ModelViewProjectionMatrix * vec4(pos, 1.0);
  gl_PointSize = size;
  depth = dot(depth_row, vec4(pos, 1.0));
}
"""
FRAGMENT = """
void main()
{
  if (depth > texture(surfaces, gl_FragCoord.xy / region).r) discard;
  shown = color;
}
"""
_batches: dict[int, gpu.types.GPUBatch | None] = {}  # session_uid of a cloud -> its selected points
_handle = None


def _draw() -> None:
    """Draw the selected points of every cloud, made anew only where something has changed; meshes of the engine hide them."""
    context = bpy.context
    if context.mode != "OBJECT" or not context.space_data.overlay.show_overlays:
        return
    depsgraph = context.evaluated_depsgraph_get()
    shown = []
    # a preview is to be looked at: nothing is drawn over it
    for scene_object in [each for each in SceneObject.among(context.scene.objects) if PREVIEW not in each.root]:
        for cloud in [cloud for cloud in scene_object.clouds if cloud.visible_get()]:
            if cloud.session_uid not in _batches:
                _batches[cloud.session_uid] = _batch(cloud, cloud.evaluated_get(depsgraph).data)
            if (batch := _batches[cloud.session_uid]) is not None:
                shown.append((batch, cloud.matrix_world))
    if not shown:
        return
    shader, depths = _shader(), _surface_depths(context.region)
    gpu.state.blend_set("ALPHA")
    gpu.state.program_point_size_set(True)
    shader.bind()
    shader.uniform_sampler("surfaces", depths.texture)
    shader.uniform_float("color", (*linear_from_srgb(np.array(COLOUR[:3])).tolist(), COLOUR[3]))
    shader.uniform_float("size", SIZE * context.preferences.system.ui_scale)
    shader.uniform_float("region", (context.region.width, context.region.height))
    for batch, matrix in shown:
        with gpu.matrix.push_pop():
            gpu.matrix.multiply_matrix(matrix)
            shader.uniform_float("depth_row", (depths.row @ np.array(matrix)).tolist())
            batch.draw(shader)
    gpu.state.program_point_size_set(False)
    gpu.state.blend_set("NONE")


@cache
def _shader() -> gpu.types.GPUShader:
    constants = {
        "ModelViewProjectionMatrix": "MAT4",
        "color": "VEC4",
        "depth_row": "VEC4",
        "size": "FLOAT",
        "region": "VEC2",
    }
    info = shader_info(constants, ("surfaces",), {"pos": "VEC3"}, {"shown": "VEC4"})
    info.vertex_out(interface("selection", {"depth": "FLOAT"}))
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)


def _surface_depths(region: bpy.types.Region) -> SurfaceDepths:
    """Return the depths of the surfaces in a viewport's picture; nothing hides anything where another engine draws it."""
    picture = viewport_gpu.shown.get(region.as_pointer())
    return (picture and picture.surface_depths) or _no_surfaces()


@cache
def _no_surfaces() -> SurfaceDepths:
    texture = gpu.types.GPUTexture((1, 1), format="R32F")
    texture.clear(format="FLOAT", value=(viewport_gpu.FARTHEST,))
    return SurfaceDepths(texture, np.zeros(4))


def _batch(cloud: bpy.types.Object, data: bpy.types.PointCloud) -> gpu.types.GPUBatch | None:
    """Return the selected points of an evaluated cloud; None where there are none."""
    rows = drawn_rows(data)
    if not len(rows):
        return None
    return batch_for_shader(_shader(), "POINTS", {"pos": carried_places(cloud, data)[rows]})


def drawn_rows(data: bpy.types.PointCloud) -> np.ndarray:
    """Return (n,) int: the selected points of an evaluated cloud that have an opacity now; most of a fast mover is not there."""
    chosen, base = read_attribute(data, SELECTED), read_attribute(data, "radiance:base")
    if chosen is None or base is None:
        return np.zeros(0, int)
    return np.flatnonzero(chosen.astype(bool) & (base[:, 3] >= FAINTEST))


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
    _shader.cache_clear()
    _no_surfaces.cache_clear()
