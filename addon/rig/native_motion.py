"""Moving Gaussians posed by the core while they play in viewports of the engine: the same places as by geometry nodes, sooner.

The modifier `Feature4X motion` is then off in viewports, not in renders, and the engine's reader asks `carried_cloud` where the
Gaussians are: the core's deformer moves them by the empties as Blender has evaluated them. Blender itself, which outlines and
picks objects, sees unposed points then. So the modifier is off only during playback, scrubbing and transforms; outlines are
hidden meanwhile, and a click or a selection tool in a viewport switches it on first. It is also on as soon as another kind of
viewport opens, a mode other than Object Mode begins, geometry nodes of others may look at the points, or the .blend is saved.
Blender saves by itself without telling anybody: what is off is marked with the property `f4x_carried`, and on again in a file
that was opened.
"""

from __future__ import annotations

import time
from dataclasses import replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...f4x_core.errors import F4xError
from ...f4x_core.geometry import pose
from ...f4x_core.native.library import open_library
from ...f4x_core.scene.carrying import Carried, Carrier
from ...f4x_core.scene.clouds import Cloud
from ..common.geometry_nodes import MOTION
from ..common.point_cloud import read_attribute
from ..common.render_settings import ENGINE
from ..common.wording import Reporting
from ..scene.scene_object import SceneObject, root_of
from .repair import ORDER
from .scaffold import NODE, NODES

GLANCE = 0.5
"""Seconds between two looks at the viewports."""
OURS = "Feature4X "
"""Prefix of the names of our modifiers."""

PAUSE = 1.0
"""Seconds that geometry nodes stay on after a press in a viewport: the click may begin a selection by box or lasso."""

WATCHES = "F4X_OT_watch_clicks"
"""Blender's name of the operator below while it runs."""
CARRIED = "f4x_carried"
"""Property of objects whose modifier we have switched off; a person may do so, too."""

_clouds: dict[int, _CarriedCloud | None] = {}  # session_uid of a cloud's object -> what carries it; None = cannot be
_unlined: set[int] = set()  # pointers of the viewports whose outlines are hidden
_pressed = -PAUSE  # when a mouse button was last pressed in a viewport


class _CarriedCloud:
    """Poses one cloud by the core, and keeps the last result."""

    def __init__(self, scene_object: SceneObject):
        scene = scene_object.base
        # the collection itself: Blender says when that is gone, but nothing of its list of objects
        collection = scene_object.root[NODES]
        nodes = collection.objects
        row = {int(id): index for index, id in enumerate(scene.scaffold.ids)}
        self._root, self._nodes, self._order = scene_object.root, collection, scene_object.root.get(ORDER)
        self._rows = np.array([row.get(item.get(NODE, -1), -1) for item in nodes])
        self.is_whole = sorted(self._rows.tolist()) == list(range(len(row)))
        """True if every node of the scaffold is there once."""
        self._carrier, self._ids = Carrier(scene), scene.dynamic.ids
        self._buffer = np.zeros(16 * len(nodes), np.float32)
        self._stood: np.ndarray | None = None
        self._now: Carried | None = None
        self._last: tuple[np.ndarray, Carried, Carried] | None = None

    @property
    def is_current(self) -> bool:
        """True if the nodes are the same as at first."""
        try:
            return self._root.get(ORDER) == self._order and len(self._nodes.objects) == len(self._rows)
        except ReferenceError:  # the root or the collection of its nodes was deleted
            return False

    def now(self) -> Carried:
        """Return the Gaussians by the empties as they stand; the very same arrays where none has moved."""
        self._nodes.objects.foreach_get("matrix_world", self._buffer)
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
        """Return which dynamic Gaussians the evaluated points are, by `gid`; None if a point is none of them."""
        gid = read_attribute(data, "gid")
        if gid is None or np.array_equal(gid, self._ids):
            return None if gid is None else slice(None)
        rows = np.minimum(np.searchsorted(self._ids, gid), len(self._ids) - 1)
        return rows if (self._ids[rows] == gid).all() else None

    def posed(self, cloud: Cloud, data: bpy.types.PointCloud) -> Cloud:
        """Return `cloud`, as its evaluated `data` hold it, carried; with the very same arrays where nothing has moved."""
        now, before = self.now(), self._last
        if before is None or before[0] is not cloud.means or before[1] is not now:
            rows = self.rows_of(data)
            if rows is None:
                return cloud
            before = self._last = cloud.means, now, Carried(now.means[rows], now.quats[rows], now.turns[rows])
        return replace(cloud, means=before[2].means, quats=before[2].quats, turn=before[2].turns)


def carried_cloud(owner: bpy.types.Object, cloud: Cloud, data: bpy.types.PointCloud) -> Cloud:
    """Return `cloud` of an object as the viewport shows it: carried by the core where its modifier is off for that."""
    carries = _carries(owner) if _is_off(owner) else None
    return cloud if carries is None else carries.posed(cloud, data)


def carried_places(owner: bpy.types.Object, data: bpy.types.PointCloud) -> np.ndarray:
    """Return (n,3) places of an object's evaluated points as the viewport shows them."""
    carries = _carries(owner) if _is_off(owner) else None
    rows = None if carries is None else carries.rows_of(data)
    return read_attribute(data, "position") if carries is None or rows is None else carries.now().means[rows]


def switch_on() -> None:
    """Let geometry nodes pose all clouds again."""
    for item in bpy.data.objects:
        if CARRIED in item and item.is_editable:
            _switch_on(item)
    for space in _viewports():
        if space.as_pointer() in _unlined:
            space.overlay.show_outline_selected = True
    _unlined.clear()
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
    """Switch motion modifiers off while the core poses Gaussians for viewports, else on; returns seconds until the next call."""
    wanted = _is_moving() and not _is_selecting() and _may_carry()
    if not wanted:
        switch_on()
    for item in bpy.context.scene.objects if wanted else ():
        if _is_off(item) and _carries(item) is None:  # a node was deleted
            _switch_on(item)
        switch_off(item)
        if _is_off(item) and item.select_get():
            _hide_outlines()
    if wanted and not _is_watched():
        _watch()
    return GLANCE


def _viewports() -> list[bpy.types.SpaceView3D]:
    """Return the 3D viewports of all windows."""
    return [
        area.spaces.active
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D"
    ]


def _hide_outlines() -> None:
    """Hide the outlines of selected objects: Blender would draw them around unposed points."""
    for space in _viewports():
        if space.overlay.show_outline_selected:
            space.overlay.show_outline_selected = False
            _unlined.add(space.as_pointer())


def _modal_operators() -> list[str]:
    """Return the names of the operators that follow the mouse at present."""
    return [operator.bl_idname for window in bpy.context.window_manager.windows for operator in window.modal_operators]


def _is_moving() -> bool:
    """Return True if an animation plays, somebody scrubs, or transforms an object."""
    screens = [window.screen for window in bpy.context.window_manager.windows]
    moves = any(screen.is_animation_playing or screen.is_scrubbing for screen in screens)
    return moves or any(name.startswith("TRANSFORM_OT") for name in _modal_operators())


def _is_selecting() -> bool:
    """Return True if somebody selects objects in a viewport at present, or is about to."""
    return time.monotonic() - _pressed < PAUSE or any("_OT_select" in name for name in _modal_operators())


def _is_watched() -> bool:
    return WATCHES in _modal_operators()


def _watch() -> None:
    """Start to watch the presses of mouse buttons in the windows."""
    for window in bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=window):
            bpy.ops.f4x.watch_clicks("INVOKE_DEFAULT")


class F4X_OT_watch_clicks(Reporting, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Let geometry nodes pose moving Gaussians before a click in a viewport selects objects."""

    bl_idname = "f4x.watch_clicks"
    bl_label = "Watch Clicks"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - read by Blender

    def invoke(self, context, event):
        """Watch until nothing is carried any more."""
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Hand on every event; a press in a viewport finds points where the picture shows them."""
        global _pressed
        if event.value == "PRESS" and event.type in ("LEFTMOUSE", "RIGHTMOUSE") and _in_viewport(context, event):
            _pressed = time.monotonic()
            switch_on()
            context.view_layer.update()
        return {"PASS_THROUGH"} if _clouds or _is_moving() else {"FINISHED", "PASS_THROUGH"}


def _in_viewport(context: bpy.types.Context, event: bpy.types.Event) -> bool:
    """Return True if the mouse is over a 3D viewport."""
    return any(
        0 <= event.mouse_x - area.x < area.width and 0 <= event.mouse_y - area.y < area.height
        for area in context.window.screen.areas
        if area.type == "VIEW_3D"
    )


def _is_off(item: bpy.types.Object) -> bool:
    return CARRIED in item and MOTION in item.modifiers and not item.modifiers[MOTION].show_viewport


def _carries(item: bpy.types.Object) -> _CarriedCloud | None:
    """Return the carrier of a cloud; None where only geometry nodes can pose it."""
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
    """Return True if every viewport shows the engine's picture, and nothing else reads the points."""
    context = bpy.context
    engine = context.scene.render.engine
    views = _viewports()
    exact = all(space.shading.type == "RENDERED" for space in views)
    others = (
        modifier.type == "NODES" and not modifier.name.startswith(OURS)
        for item in context.scene.objects
        for modifier in item.modifiers
    )
    return engine == ENGINE and bool(views) and exact and context.mode == "OBJECT" and not any(others)


@persistent
def _let_nodes_pose(*_) -> None:
    switch_on()


@persistent
def _changed(*_) -> None:
    _clouds.clear()


HANDLERS = {
    "save_pre": _let_nodes_pose,
    "load_post": _let_nodes_pose,
    "animation_playback_post": _let_nodes_pose,
    "undo_post": _changed,
    "redo_post": _changed,
}


def register() -> None:
    """Begin to look; without a window or the compiled library nothing is switched off."""
    if not bpy.app.background and open_library()[0] is not None:
        bpy.app.timers.register(look, first_interval=GLANCE, persistent=True)


def unregister() -> None:
    """Undo `register`."""
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)
        switch_on()


CLASSES = (F4X_OT_watch_clicks,)
