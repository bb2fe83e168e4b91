"""Objects that were in the file before and stand between the clip's camera and what it sees, such as Blender's default cube."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import bpy
import numpy as np
from mathutils import Vector

from ..common.axes import camera_eye
from ..rig import native_motion
from . import evaluated

IN_THE_WAY = 1 / 3
"""Fraction of the Gaussians in view from which on an object that hides them is no prop but in the way."""
RAYS = 300
"""Gaussians in view that are looked for at each frame."""
SHOWN = 0.99
"""Fraction of the way to a Gaussian that has to be free: an object may stand on what the scene shows."""


def hide_occluders(root: bpy.types.Object, frames: Iterable[int]) -> str:
    """Hide objects that are in the way at one of `frames`, in renders too; returns one sentence about it, or nothing."""
    scene = bpy.context.scene
    native_motion.switch_on()  # it is the evaluated points that may be hidden
    present, names = scene.frame_current, []
    for frame in frames:
        scene.frame_set(frame)
        while (item := _largest_occluder(root)) is not None:
            item.hide_set(True)
            item.hide_render = True
            names.append(item.name)
    scene.frame_set(present)
    if not names:
        return ""
    return f"Hidden, as it was in the way: {', '.join(names)}."


def _largest_occluder(root: bpy.types.Object) -> bpy.types.Object | None:
    """Return the visible object that hides most of the scene from the scene's camera at this frame, if it is in the way."""
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    centre = scene.camera.matrix_world.translation.copy()
    points, own = _points_in_view(scene, depsgraph), {root, *root.children_recursive}
    hit: Counter[bpy.types.Object] = Counter()
    for point in points:
        way = Vector(point) - centre
        found, _, _, _, item, _ = scene.ray_cast(depsgraph, centre, way.normalized(), distance=SHOWN * way.length)
        if found and item.original not in own:
            hit[item.original] += 1
    item, count = hit.most_common(1)[0] if hit else (None, 0)
    return item if count > IN_THE_WAY * len(points) else None


def _points_in_view(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Return the centres (n,3) of some of the Gaussians that the camera sees, evenly among them, in Blender's world."""
    render = scene.render
    eye = camera_eye(scene.camera, scene, depsgraph, render.resolution_x, render.resolution_y)
    clouds, _ = evaluated.stage(depsgraph)
    centres = [cloud.means @ cloud.to_world[:3, :3].T + cloud.to_world[:3, 3] for cloud in clouds]
    points = np.concatenate([np.zeros((0, 3)), *centres])
    pixels, depth = eye.camera.project(points)
    seen = (depth > eye.near) & (pixels > 0).all(1) & (pixels < (render.resolution_x, render.resolution_y)).all(1)
    points = points[seen]
    return points[:: max(1, len(points) // RAYS)]
