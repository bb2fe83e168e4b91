"""Moving Gaussians posed by the core while all viewports show the engine's picture: the same places as by geometry nodes, sooner.

The modifier `Feature4X motion` is then off in viewports, not in renders, and the engine's reader asks `carried_cloud` where the
Gaussians are: the core's deformer moves them by the empties as Blender has evaluated them. As soon as another kind of viewport
opens, a mode other than Object Mode begins, geometry nodes of others may look at the points, or the .blend is saved, the
modifier is on again. Blender saves by itself without telling anybody: what is off is marked with the property `f4x_carried`, and
on again in a file that was opened.
"""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..f4x_core.errors import F4xError
from ..f4x_core.geometry import pose
from ..f4x_core.native.library import open_library
from ..f4x_core.scene.carrying import Carried, Carrier
from ..f4x_core.scene.stage import Cloud
from .motion_nodes import MOTION
from .point_cloud import read_attribute
from .render_settings import ENGINE
from .rig_repair import ORDER
from .scaffold_rig import NODE, NODES
from .scene_object import SceneObject, root_of

GLANCE = 0.5
"""Seconds between two looks at the viewports."""
OURS = "Feature4X "
"""How the names of our modifiers begin."""

CARRIED = "f4x_carried"
"""Property of objects whose modifier we have switched off; a person may do so, too."""

_clouds: dict[int, _CarriedCloud | None] = {}  # session_uid of a cloud's object -> what carries it; None = cannot be


class _CarriedCloud:
    """What carries one cloud, and where that was last."""

    def __init__(self, scene_object: SceneObject):
        scene = scene_object.base
        nodes = scene_object.root[NODES].objects
        row = {int(id): index for index, id in enumerate(scene.scaffold.ids)}
        self._root, self._nodes, self._order = scene_object.root, nodes, scene_object.root.get(ORDER)
        self._rows = np.array([row.get(item.get(NODE, -1), -1) for item in nodes])
        self.is_whole = sorted(self._rows.tolist()) == list(range(len(row)))
        """Whether every node of the scaffold is there once."""
        self._carrier, self._ids = Carrier(scene), scene.dynamic.ids
        self._buffer = np.zeros(16 * len(nodes), np.float32)
        self._stood: np.ndarray | None = None
        self._now: Carried | None = None
        self._last: tuple[np.ndarray, Carried, Carried] | None = None

    @property
    def is_current(self) -> bool:
        """Whether there are the same nodes as at first."""
        try:
            return self._root.get(ORDER) == self._order and len(self._nodes) == len(self._rows)
        except ReferenceError:  # the root or the collection of its nodes was deleted
            return False

    def now(self) -> Carried:
        """The Gaussians by the empties as they stand; the very same arrays where none has moved."""
        self._nodes.foreach_get("matrix_world", self._buffer)
        to_scene = np.linalg.inv(np.array(self._root.matrix_world, np.float64))
        # Blender gives matrices column by column
        stand = to_scene @ self._buffer.reshape(-1, 4, 4).transpose(0, 2, 1)
        if self._now is None or not np.array_equal(stand, self._stood):
            self._stood = stand.copy()
            stand[:, :3, :3] /= np.linalg.norm(
                stand[:, :3, :3], axis=-2, keepdims=True
            )  # an empty's size takes no part
            order = np.argsort(self._rows)
            quat, xyz = pose.from_matrix(stand[order])
            self._now = self._carrier.carried(xyz, quat)
        return self._now

    def rows_of(self, data: bpy.types.PointCloud) -> np.ndarray | slice | None:
        """Which dynamic Gaussians evaluated points are; None where some are not."""
        gid = read_attribute(data, "gid")
        if gid is None or np.array_equal(gid, self._ids):
            return None if gid is None else slice(None)
        rows = np.minimum(np.searchsorted(self._ids, gid), len(self._ids) - 1)
        return rows if (self._ids[rows] == gid).all() else None

    def posed(self, cloud: Cloud, data: bpy.types.PointCloud) -> Cloud:
        """`cloud`, as its evaluated `data` hold it, carried; with the very same arrays where nothing has moved."""
        now, before = self.now(), self._last
        if before is None or before[0] is not cloud.means or before[1] is not now:
            rows = self.rows_of(data)
            if rows is None:
                return cloud
            before = self._last = cloud.means, now, Carried(now.means[rows], now.quats[rows], now.turns[rows])
        return replace(cloud, means=before[2].means, quats=before[2].quats, turn=before[2].turns)


def carried_cloud(owner: bpy.types.Object, cloud: Cloud, data: bpy.types.PointCloud) -> Cloud:
    """`cloud` of an object as the viewport shows it: carried by the core where its modifier is off for that."""
    carries = _carries(owner) if _is_off(owner) else None
    return cloud if carries is None else carries.posed(cloud, data)


def carried_places(owner: bpy.types.Object, data: bpy.types.PointCloud) -> np.ndarray:
    """(n,3) places of an object's evaluated points as the viewport shows them."""
    carries = _carries(owner) if _is_off(owner) else None
    rows = None if carries is None else carries.rows_of(data)
    return read_attribute(data, "position") if carries is None or rows is None else carries.now().means[rows]


def switch_on() -> None:
    """Let geometry nodes pose all clouds again."""
    for item in bpy.data.objects:
        if CARRIED in item and item.is_editable:
            _switch_on(item)
    _clouds.clear()


def switch_off(item: bpy.types.Object) -> None:
    """Let the core pose a cloud in viewports, if it can and geometry nodes do."""
    if (
        item.type == "POINTCLOUD"
        and MOTION in item.modifiers
        and item.modifiers[MOTION].show_viewport
        and _carries(item)
    ):
        item[CARRIED] = True
        item.modifiers[MOTION].show_viewport = False


def _switch_on(item: bpy.types.Object) -> None:
    """Let geometry nodes pose a cloud that the core has posed."""
    del item[CARRIED]
    if MOTION in item.modifiers:
        item.modifiers[MOTION].show_viewport = True


def look() -> float:
    """Switch modifiers off or on, as the viewports want it. Returns the seconds until the next look."""
    wanted = _may_carry()
    if not wanted:
        switch_on()
    for item in bpy.context.scene.objects if wanted else ():
        if _is_off(item) and _carries(item) is None:  # a node was deleted
            _switch_on(item)
        switch_off(item)
    return GLANCE


def _is_off(item: bpy.types.Object) -> bool:
    return CARRIED in item and MOTION in item.modifiers and not item.modifiers[MOTION].show_viewport


def _carries(item: bpy.types.Object) -> _CarriedCloud | None:
    """What carries a cloud; None where only geometry nodes can."""
    known = _clouds.get(item.session_uid)
    if item.session_uid not in _clouds or (known is not None and not known.is_current):
        _clouds[item.session_uid] = known = _new_carrier(item)
    return known


def _new_carrier(item: bpy.types.Object) -> _CarriedCloud | None:
    root = root_of(item)  # not `SceneObject.of`: a cloud without a root is no part of the only scene that there is
    if root is None or SceneObject(root).is_linked or root.get(NODES) is None:
        return None
    try:
        found = _CarriedCloud(SceneObject(root))
    except F4xError:  # the file is gone; the points are in the .blend
        return None
    return found if found.is_whole else None


def _may_carry() -> bool:
    """Whether every viewport shows the engine's picture, and nobody else looks at the points."""
    context = bpy.context
    engine = context.scene.render.engine
    areas = [
        area for window in context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"
    ]
    exact = all(area.spaces.active.shading.type == "RENDERED" for area in areas)
    others = (
        modifier.type == "NODES" and not modifier.name.startswith(OURS)
        for item in context.scene.objects
        for modifier in item.modifiers
    )
    return engine == ENGINE and bool(areas) and exact and context.mode == "OBJECT" and not any(others)


@persistent
def _saving_or_opened(*_) -> None:
    switch_on()


@persistent
def _changed(*_) -> None:
    _clouds.clear()


_HANDLERS = {
    "save_pre": _saving_or_opened,
    "load_post": _saving_or_opened,
    "undo_post": _changed,
    "redo_post": _changed,
}


def register() -> None:
    """Begin to look; without a window or the compiled library nothing is switched off."""
    for name, function in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(function)
    if not bpy.app.background and open_library()[0] is not None:
        bpy.app.timers.register(look, first_interval=GLANCE, persistent=True)


def unregister() -> None:
    """Undo `register`."""
    for name, function in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(function)
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)
        switch_on()
