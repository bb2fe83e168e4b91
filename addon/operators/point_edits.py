"""Points that were deleted or moved with Blender's own tools: what no edit of the scene holds yet, and an edit of it.

Import writes every Gaussian of the file as a point, at its own place. So a Gaussian without a point was deleted, and a point that
is elsewhere was moved. Taking them over appends a removal and transforms, and puts all points back as import wrote them.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.edit.operations import NOTHING_ALONG, Delete, Operation, Transform
from ...f4x_core.edit.selects import Ids
from ...f4x_core.errors import F4xError
from ...f4x_core.geometry.similarity import Similarity, split_by_motion
from ...f4x_core.language.lexicon import plural
from ...f4x_core.scene import DynamicSet, StaticSet
from ..common.point_cloud import new_point_cloud, read_attribute, write_attribute
from ..common.undo import leave_mode
from ..edits import display
from ..io.import_scene import extras_of, write_bindings, write_gaussians
from ..scene.scene_object import APART, SceneObject
from .base import SceneOperator

MAX_MOTIONS = 16
"""Number of groups of points, each moved as one, that are taken over at once."""

_found: dict[int, str] = {}  # session_uid of a root -> `PointChanges.summary` since Blender saw a change


@dataclass(frozen=True, eq=False)
class PointChanges:
    """Differences of a scene's points from what import wrote."""

    deleted: np.ndarray
    """(n,) ids of Gaussians without a point that no edit removes."""
    moved: tuple[tuple[np.ndarray, Similarity], ...]
    """(ids (m,), how they were moved) of static Gaussians, in groups that move as one."""
    left: np.ndarray
    """(n,) ids of moved points that no edit can hold: they belong to a moving thing, or went each its own way."""

    @property
    def summary(self) -> str:
        """Return a line for the panel; empty where nothing differs."""
        count = sum(len(ids) for ids, _ in self.moved) + len(self.left)
        parts = [f"{len(self.deleted):,} deleted"] if len(self.deleted) else []
        parts += [f"{count:,} moved"] if count else []
        return f"Changed by Blender's own tools and not yet an edit: {' and '.join(parts)}" if parts else ""

    @property
    def operations(self) -> tuple[Operation, ...]:
        """The edits that do the same."""
        moves = (
            Transform(
                Ids.of(ids),
                translate=_vector(motion.translation),
                rotate=_vector(motion.rotation_degrees),
                scale=round(motion.scale, 7),
                pivot=_vector(motion.pivot),
                along=NOTHING_ALONG,
            )
            for ids, motion in self.moved
        )
        return (*((Delete(Ids.of(self.deleted), along=NOTHING_ALONG),) if len(self.deleted) else ()), *moves)


def changes_of(scene_object: SceneObject) -> PointChanges:
    """Compare the points with the scene's file. Raises F4xError without the file."""
    base = scene_object.base
    there, differs = np.zeros(len(base.ids), bool), np.zeros(len(base.ids), bool)
    before = np.concatenate([base.static.means, base.dynamic.means])
    after = before.copy()
    own = len(base.ids)
    for cloud, at, row in scene_object.points():
        if APART in cloud:
            continue
        at, row = at[row < own], row[row < own]
        positions = read_attribute(cloud.data, "position")[at]
        there[row] = True
        differs[row] = (positions != before[row]).any(1)
        after[row] = positions
    deleted = base.ids[~there & scene_object.pending.there[:own]]
    moved = np.flatnonzero(differs & there & (np.arange(own) < len(base.static)))
    groups, rest = split_by_motion(before[moved], after[moved], MAX_MOTIONS)
    left = np.concatenate([moved[rest], np.flatnonzero(differs & there & (np.arange(own) >= len(base.static)))])
    return PointChanges(
        deleted, tuple((base.ids[moved[group]], motion) for group, motion in groups), base.ids[left].astype(np.int64)
    )


def summary(scene_object: SceneObject) -> str:
    """Return `PointChanges.summary`, worked out only after Blender saw a change: panels are drawn often."""
    uid = scene_object.root.session_uid
    if uid not in _found:
        try:
            _found[uid] = changes_of(scene_object).summary
        except F4xError:
            _found[uid] = ""
    return _found[uid]


def put_back(scene_object: SceneObject) -> None:
    """Write all points of the two base clouds as import wrote them; selection, hidden points and scores are kept.

    A cloud whose points are in several objects by now keeps its missing points missing.
    """
    base = scene_object.base
    kept = scene_object.marks
    for part, extras in zip((base.static, base.dynamic), extras_of(base), strict=True):
        owners = _owners(scene_object, part)
        for cloud in owners:
            _restore_positions(cloud.data, part)
        if len(owners) == 1 and len(owners[0].data.points) < len(part):
            old = owners[0].data
            new = _spare_data(old, len(part))
            write_gaussians(new, part, extras)
            if isinstance(part, DynamicSet):
                write_bindings(new, part)
            owners[0].data = new
            _replace_name(old, new)
    scene_object.write(**kept)


def _owners(scene_object: SceneObject, part: StaticSet) -> list[bpy.types.Object]:
    """Return the clouds that show Gaussians of `part`."""
    clouds = [cloud for cloud in scene_object.clouds if APART not in cloud]
    return [cloud for cloud in clouds if np.isin(read_attribute(cloud.data, "gid"), part.ids).any()]


def _restore_positions(data: bpy.types.PointCloud, part: StaticSet) -> None:
    gid, positions = read_attribute(data, "gid"), read_attribute(data, "position")
    order = np.argsort(part.ids)
    at = order[np.minimum(np.searchsorted(part.ids, gid, sorter=order), len(order) - 1)]
    known = part.ids[at] == gid
    positions[known] = part.means[at[known]]
    write_attribute(data, "position", "FLOAT_VECTOR", positions)
    data.update_tag()


def _spare_data(old: bpy.types.PointCloud, count: int) -> bpy.types.PointCloud:
    """Return a point cloud of `count` points with the materials and the custom properties of `old`."""
    item = new_point_cloud(f"{old.name} whole", count, bpy.context.scene.collection)
    new = item.data
    bpy.data.objects.remove(item)
    for material in old.materials:
        new.materials.append(material)
    for name, value in old.items():
        new[name] = value
    return new


def _replace_name(old: bpy.types.PointCloud, new: bpy.types.PointCloud) -> None:
    name = old.name
    if not old.users:
        bpy.data.pointclouds.remove(old)
    new.name = name


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 7) for value in values)
    return x, y, z


class F4X_OT_take_over_points(SceneOperator, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Make edits of points that were deleted or moved in Edit Mode, so that saving, exporting and rendering elsewhere know them."""

    bl_idname, bl_label = "f4x.take_over_points", "Take Over Deleted and Moved Points"

    def act(self, context, scene_object):
        """Append the edits, and put the points back, which the edits now remove and move."""
        leave_mode()
        found = changes_of(scene_object)
        if not found.operations:
            raise F4xError(self._refusal(found))
        scene_object.append(*found.operations, sentence="in Edit Mode")
        put_back(scene_object)
        display.refresh(scene_object)
        if len(found.left):
            self.report({"WARNING"}, f"{self._refusal(found)} They were put back.")
        count = len(found.operations)
        self.report({"INFO"}, f"{found.summary.partition(': ')[2]}: {count} {plural('edit', count)}")

    def _refusal(self, found: PointChanges) -> str:
        if not len(found.left):
            return "No point was deleted or moved in Edit Mode."
        return (
            f"{len(found.left):,} moved {plural('point', len(found.left))} cannot become an edit: what moves in the clip is"
            " edited by Move, Rotate, Scale or by its nodes, and points of the background have to move together."
        )


class F4X_OT_put_back_points(SceneOperator, bpy.types.Operator):  # noqa: N801
    """Put back all points that were deleted or moved in Edit Mode."""

    bl_idname, bl_label = "f4x.put_back_points", "Put Back"

    def act(self, context, scene_object):
        """Write the points as import wrote them."""
        leave_mode()
        put_back(scene_object)
        display.refresh(scene_object)
        if len(lost := changes_of(scene_object).deleted):
            raise F4xError(
                f"The point cloud of {len(lost):,} {plural('Gaussian', len(lost))} is gone; Ctrl-Z brings it back,"
                " or import the scene again."
            )


@persistent
def _changed(*_) -> None:
    _found.clear()


HANDLERS = dict.fromkeys(("depsgraph_update_post", "undo_post", "redo_post", "load_post"), _changed)

CLASSES = (F4X_OT_take_over_points, F4X_OT_put_back_points)
