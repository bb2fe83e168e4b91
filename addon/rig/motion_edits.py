"""Conversion between the keys of the nodes in Blender and the `rekey` edits of the scene, in both directions."""

from __future__ import annotations

import json

import bpy
import numpy as np

from ...f4x_core.edit.apply import EditedScene
from ...f4x_core.edit.operations import Rekey
from ...f4x_core.errors import F4xError
from ...f4x_core.scaffold import Scaffold
from ..scene.clip_time import keys_in_force, time_of
from ..scene.scene_object import SceneObject
from .scaffold import all_nodes, nodes_of, poses_now, poses_of, read_poses, write_poses

SHOWN = "f4x_keys"
"""Property of the root: JSON of the ids of the `rekey` edits that its nodes were keyed by."""
ROUNDING = 3e-6
"""Maximum rounding error of quaternions and of positions (relative above 1) after conversion to float32 matrices."""


def changes(scene_object: SceneObject) -> Rekey | None:
    """Return the poses that differ from the pending edits', at every clip frame at which any does; None where none does.

    They are read as Blender evaluates them. Raises F4xError where nodes are missing.
    """
    scene = scene_object.edited
    curves, frames = _curves(scene_object), scene.cameras.times
    nodes = all_nodes(scene_object.root, curves.ids)
    old_xyz, old_quat = poses_of(curves, frames)
    xyz, quat = read_poses(scene_object.root, nodes, frames)
    moved = _differ(scene_object.root, xyz, quat, old_xyz, old_quat)  # (T,M)
    when, who = np.flatnonzero(moved.any(1)), np.flatnonzero(moved.any(0))
    if not len(who):
        return None
    block = np.ix_(when, who)
    kept = ~moved[block][..., None]
    xyz, quat = np.where(kept, old_xyz[block], xyz[block]), np.where(kept, old_quat[block], quat[block])
    return Rekey.of(curves.ids[who], frames[when], xyz, quat)


def unwritten(scene_object: SceneObject) -> int:
    """Count the nodes whose poses at the current frame differ from the pending edits: moved, and not written back.

    Between clip frames, where Blender and the core interpolate differently, and without the scene file it is 0.
    """
    frame, nodes = time_of(scene_object.root), nodes_of(scene_object.root)
    try:
        scene = scene_object.edited
    except F4xError:
        return 0
    if not nodes or frame not in scene.cameras.times:
        return 0
    curves = _curves(scene_object)
    there = [i for i, id in enumerate(curves.ids.tolist()) if id in nodes]
    old_xyz, old_quat = (values[:, there] for values in poses_of(curves, np.array([frame])))
    xyz, quat = poses_now(scene_object.root, [nodes[curves.ids[i]] for i in there])
    return int(_differ(scene_object.root, xyz[None], quat[None], old_xyz, old_quat).sum())


def refresh_keys(scene_object: SceneObject) -> None:
    """Key the nodes anew where edits were undone, redone or switched since they were keyed last."""
    ids = _shown_ids(scene_object)
    if scene_object.root.get(SHOWN, "[]") == ids:
        return
    curves, frames, found = _curves(scene_object), scene_object.edited.cameras.times, nodes_of(scene_object.root)
    there = [i for i, id in enumerate(curves.ids.tolist()) if id in found]
    nodes = [found[curves.ids[i]] for i in there]
    xyz, quat = (values[:, there] for values in poses_of(curves, frames))
    with keys_in_force(scene_object.root):
        now_xyz, now_quat = read_poses(scene_object.root, nodes, frames)
        moved = np.flatnonzero(_differ(scene_object.root, now_xyz, now_quat, xyz, quat).any(0))
        if len(moved):
            write_poses(scene_object.root, [nodes[i] for i in moved], frames, xyz[:, moved], quat[:, moved])
    if len(moved):
        bpy.context.scene.frame_set(bpy.context.scene.frame_current)
    scene_object.root[SHOWN] = ids


def mark_keyed(scene_object: SceneObject) -> None:
    """Remember that the nodes are keyed by the pending edits: they were just imported so, or just written back."""
    scene_object.root[SHOWN] = _shown_ids(scene_object)


def _shown_ids(scene_object: SceneObject) -> str:
    edits = scene_object.stack.edits
    return json.dumps([edit.id for edit in edits if edit.enabled and isinstance(edit.operation, Rekey)])


def _curves(scene_object: SceneObject) -> Scaffold:
    scene = scene_object.edited
    curves = scene.curves if isinstance(scene, EditedScene) else scene.scaffold
    assert curves is not None  # there are nodes
    return curves


def _differ(
    root: bpy.types.Object, xyz: np.ndarray, quat: np.ndarray, other_xyz: np.ndarray, other_quat: np.ndarray
) -> np.ndarray:
    """Return (T,n) bool: whether poses differ by more than rounding, which grows with the distance from Blender's origin."""
    away = max(1.0, *(abs(value) for value in root.matrix_world.translation))
    reach = ROUNDING * np.maximum(away, np.abs(other_xyz).max(-1))
    turned = np.minimum(np.abs(quat - other_quat).max(-1), np.abs(quat + other_quat).max(-1))
    return (np.abs(xyz - other_xyz).max(-1) > reach) | (turned > ROUNDING)
