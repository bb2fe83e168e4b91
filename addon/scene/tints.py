"""Colors over time in Blender: the tints of a scene as point attributes, the modifier that adds them, and its switch.

Each knot, a clip time of `Scene.tints`, is an attribute `.f4x_tint_0`, `.f4x_tint_1` ... INT: red 256^2 + green 256 + blue, each
from -127 to 127, so that points that an artist joins, which have 0 there, keep their color. `.f4x_tint_gain` FLOAT_VECTOR
multiplies them: what edits leave of them, 0 under a heat map. Geometry nodes (`geometry_nodes.build_tints_tree`) do the rest,
without a handler: in background renders, on farms, in links and without the extension. The switch is the modifier's own.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...f4x_core.scene import Scene
from ...f4x_core.scene.tints import LARGEST
from ..common.geometry_nodes import BYTE, TINT, TINT_GAIN, TINTS, build_tints_tree
from ..common.point_cloud import write_attribute
from . import clip_time


def tints_of(scene: Scene) -> np.ndarray | None:
    """Return (M,K,3) int8 tints of the M Gaussians of the base at K knots, static ones first; None where colors stay."""
    return None if scene.tints is None else np.concatenate(scene.tints.parts)


def write_tints(cloud: bpy.types.PointCloud, tints: np.ndarray) -> None:
    """Write the attributes of `tints (n,K,3)`, as no edit changes them."""
    weights = np.array([BYTE**2, BYTE, 1], np.int32)
    for knot in range(tints.shape[1]):
        steps = np.clip(tints[:, knot].astype(np.int32), -LARGEST, LARGEST)
        write_attribute(cloud, f"{TINT}{knot}", "INT", steps @ weights)
    write_gain(cloud, np.ones((len(tints), 3), np.float32))


def write_gain(cloud: bpy.types.PointCloud, gain: np.ndarray) -> None:
    """Write by how much the tints are multiplied, (n,3)."""
    write_attribute(cloud, TINT_GAIN, "FLOAT_VECTOR", gain)


def add_tints(root: bpy.types.Object, item: bpy.types.Object, times: np.ndarray, on: bool = True) -> None:
    """Add the modifier to a point cloud that has the attributes, for knots at clip times `times (K,)`."""
    modifier = item.modifiers.new(TINTS, "NODES")
    modifier.node_group = bpy.data.node_groups.get(TINTS) or build_tints_tree(TINTS)
    modifier.show_expanded = False
    clip_time.drive_input(root, item, TINTS, "Knot", times)
    _switch(modifier, on)


def are_shown(clouds: list[bpy.types.Object]) -> bool:
    """Return True if the point clouds of a scene show its colors over time, or have none."""
    return all(modifier.show_render for modifier in _modifiers(clouds))


def are_there(clouds: list[bpy.types.Object]) -> bool:
    """Return True if point clouds of a scene have colors over time."""
    return bool(_modifiers(clouds))


def show(clouds: list[bpy.types.Object], on: bool) -> None:
    """Show the colors over time of point clouds, or those of the mean over the clip."""
    for modifier in _modifiers(clouds):
        _switch(modifier, on)


def _modifiers(clouds: list[bpy.types.Object]) -> list[bpy.types.Modifier]:
    return [cloud.modifiers[TINTS] for cloud in clouds if TINTS in cloud.modifiers]


def _switch(modifier: bpy.types.Modifier, on: bool) -> None:
    modifier.show_viewport = modifier.show_render = on
