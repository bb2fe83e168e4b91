"""Clip time in Blender: which clip frame a scene shows at which frame of the timeline.

It is kept in custom properties of the root, so that it works without the extension, in links and under Undo:

    f4x_first, f4x_last   first and last frame of the clip
    f4x_start             frame of the timeline at which the first one is shown
    f4x_rate              clip frames per frame of the timeline
    f4x_time              the clip frame that is shown: `first + (frame - start) * rate`, or as an artist keys or drives it
    f4x_placed            start and rate by which the keys below the root are placed; actions have it, too: undo brings back a root
                          and not an action that is the same in both steps, though its keys were moved since
    f4x_looked_up         whether Time looks up what is keyed below the root

While Time follows the timeline, everything that is keyed below the root has its keys on the timeline: there they can be
seen and changed like any other. Once Time is animated otherwise, each of these F-curves gets a driver beside it, with the
same keys at clip frames, that looks up Time. Blender prefers drivers to keys, and without them the keys are in force again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..common.animation import copy_keys, curves_of, move_keys, move_strips, write_keys
from ..common.geometry_nodes import PRESENCE

FIRST, LAST, START, RATE, TIME = "f4x_first", "f4x_last", "f4x_start", "f4x_rate", "f4x_time"
PLACED, LOOKED_UP = "f4x_placed", "f4x_looked_up"
FOLLOWING = "first + (frame - start) * rate"
"""Expression of the driver by which Time follows the timeline."""
OFFSET = "background_images[0].image_user.frame_offset"
CONFORMED = 2e-3
"""Largest relative difference of two rates that are played frame by frame, as 23.976 and 24."""
NEAR = 1e-3
"""Clip frames within which a key is put on a whole frame, so that moving keys to and fro loses nothing."""

ROUNDING = 1e-4
"""Clip frames by which Time, in single precision, may miss a whole one."""

DIGITS = 6
"""Decimals of the rate: Blender's properties are in single precision, in which 0.8 is not 0.8."""

_held: set[int] = set()  # session_uid of roots whose keys are in force for a while, whatever Time does


@dataclass(frozen=True)
class Timing:
    """A clip on the timeline, as long as Time follows that."""

    first: float
    """First frame of the clip."""
    start: float
    """Frame of the timeline at which it is shown."""
    rate: float
    """Clip frames per frame of the timeline."""

    def times_at(self, frames: np.ndarray) -> np.ndarray:
        """Return the clip frames that are shown at frames of the timeline; they may lie outside the clip."""
        return self.first + (np.asarray(frames, float) - self.start) * self.rate

    def frames_of(self, times: np.ndarray) -> np.ndarray:
        """Return the frames of the timeline at which clip frames are shown."""
        return self.start + (np.asarray(times, float) - self.first) / self.rate


@dataclass(frozen=True)
class Numbers:
    """Numbers of the images that a clip shows: `first`, `first + step` and so on, one for each clip frame."""

    first: int
    step: int
    count: int


def set_up(root: bpy.types.Object, first: float, last: float, rate: float = 1.0) -> None:
    """Give a root clip time: its clip starts at frame `first` of the timeline, where the keys below it are."""
    root[FIRST], root[LAST], root[START], root[RATE], root[TIME] = (float(n) for n in (first, last, first, 1, first))
    root[PLACED], root[LOOKED_UP] = (float(first), 1.0), False
    root.id_properties_ui(TIME).update(description="Clip frame that is shown", precision=3)
    _follow(root)
    for item in root.children:
        _drive_presence(root, item)
    place(root, first, rate)


def rate_between(clip_fps: float, scene: bpy.types.Scene) -> float:
    """Clip frames per frame of `scene` that play a clip at its own pace; 1 where the rates are nearly the same."""
    rate = clip_fps * scene.render.fps_base / scene.render.fps
    return 1.0 if abs(rate - 1) < CONFORMED else rate


def is_still(root: bpy.types.Object) -> bool:
    """Return True for a scene of one moment, such as splats of another program."""
    return root.get(FIRST) is not None and root[FIRST] == root[LAST]


def timing_of(root: bpy.types.Object) -> Timing:
    """Return the timing of a scene; while it is being imported clip frame n is shown at frame n."""
    return Timing(*(float(root.get(name, default)) for name, default in ((FIRST, 0), (START, 0), (RATE, 1))))


def time_of(root: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> float:
    """Return the clip frame that a scene shows now, not clamped to the clip; `depsgraph`: of a render that evaluates it."""
    time = _exact_time(root, depsgraph)
    return float(round(time)) if abs(time - round(time)) < ROUNDING else time


def _exact_time(root: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None) -> float:
    frame = bpy.context.scene.frame_current_final
    if follows_timeline(root):
        return float(timing_of(root).times_at(frame))
    data = root.animation_data
    curve = None if data is None or data.drivers.find(_path(TIME)) or data.nla_tracks else _time_curve(root)
    if curve is not None and not curve.mute:
        return curve.evaluate(frame)
    return float((root if depsgraph is None else root.evaluated_get(depsgraph))[TIME])


def follows_timeline(root: bpy.types.Object) -> bool:
    """Return True if Time follows the timeline: no artist has keyed, driven or stopped it."""
    driver = root.animation_data.drivers.find(_path(TIME)) if root.animation_data else None
    return TIME not in root or (driver is not None and driver.driver.expression == FOLLOWING and not driver.mute)


def place(root: bpy.types.Object, start: float, rate: float) -> None:
    """Let the first frame of the clip be shown at frame `start`, and `rate` clip frames per frame; all keys move along.

    A root of another file stays as it is.
    """
    if not _is_own(root):
        return
    root[START], root[RATE] = float(start), round(float(rate), DIGITS)
    _place_keys(root)
    if tuple(root[PLACED]) != (root[START], root[RATE]):
        moved = _moved(root, root[PLACED])
        for datablock in _datablocks(root):
            move_strips(datablock, moved)
        root[PLACED] = (root[START], root[RATE])
    root.update_tag()


def _place_keys(root: bpy.types.Object) -> None:
    """Put the keys below a root, and those of its Time, where its timing wants them, if they are elsewhere."""
    wanted, of_time = (root[START], root[RATE]), _time_curve(root)
    curves = [*_own_curves(root), *([of_time] if of_time else [])]
    placed = {curve.id_data: tuple(curve.id_data.get(PLACED, root[PLACED])) for curve in curves}
    for curve in curves:
        if placed[curve.id_data] != wanted:
            move_keys(curve, _moved(root, placed[curve.id_data]))
    for action in placed:
        action[PLACED] = wanted


def _moved(root: bpy.types.Object, placed: tuple[float, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that moves frames from where start and rate `placed` put them to where the timing of a root does."""
    old, new = Timing(root[FIRST], *placed), timing_of(root)
    return lambda frames: new.frames_of(_snapped(old.times_at(frames)))


def animate(root: bpy.types.Object, on: bool) -> None:
    """Let Time be keyed - at first so that the clip plays as before - or follow the timeline again; its keys are kept.

    A root of another file stays as it is.
    """
    if not _is_own(root):
        return
    if on and follows_timeline(root):
        root.driver_remove(_path(TIME))
        if _time_curve(root) is None:
            for time, frame in zip(
                (root[FIRST], root[LAST]), timing_of(root).frames_of([root[FIRST], root[LAST]]), strict=True
            ):
                root[TIME] = time
                root.keyframe_insert(_path(TIME), frame=frame)
            for key in _time_curve(root).keyframe_points:
                key.interpolation = "LINEAR"
    elif not on and not follows_timeline(root):
        root.driver_remove(_path(TIME))
        _follow(root)
    keep(root)
    root.update_tag()


def keep(root: bpy.types.Object) -> None:
    """Put right what does not go with the properties of a root, whoever changed them."""
    if TIME not in root or root.session_uid in _held:
        return
    if tuple(root[PLACED]) != (root[START], root[RATE]):
        place(root, root[START], root[RATE])
    if follows_timeline(root) == root[LOOKED_UP]:
        _look_up(root, not root[LOOKED_UP])


@contextmanager
def keys_in_force(root: bpy.types.Object) -> Iterator[Timing]:
    """Let the nodes follow their keys on the timeline in a `with` block, however Time is animated; yield where keys are then."""
    looked_up = root.get(LOOKED_UP, False)
    _held.add(root.session_uid)
    try:
        if looked_up:
            _look_up(root, False)
        yield timing_of(root)
    finally:
        if looked_up:
            _look_up(root, True)
        _held.discard(root.session_uid)


def drive_background(root: bpy.types.Object, camera: bpy.types.Camera, images: Numbers) -> None:
    """Let the clip behind a camera below `root` follow Time."""
    index = f"clamp(round(time - {root[FIRST]}), 0, {images.count - 1})"
    _drive(camera, OFFSET, f"{images.first - 1} + {images.step} * {index}", root, time=TIME)


def retarget(root: bpy.types.Object, original: bpy.types.Object) -> None:
    """Let the objects below a copied root follow the Time of the copy instead of the original's."""
    for item in root.children_recursive:
        if item.type == "CAMERA" and item.data.users > 1:  # the clip behind it has a time of its own
            item.data = item.data.copy()
    for datablock in _datablocks(root):
        for curve in datablock.animation_data.drivers if datablock.animation_data else ():
            for target in (target for variable in curve.driver.variables for target in variable.targets):
                if target.id == original:
                    target.id = root


def drive_input(
    root: bpy.types.Object, item: bpy.types.Object, modifier: str, socket: str, times: np.ndarray | None = None
) -> None:
    """Let an input of a modifier of `item` follow Time, clamped to the clip; with increasing `times (K,)` their number instead.

    Between two of them it is linear, outside as at the end: the driver's own keys say so, and nodes need not search.
    """
    held = item.modifiers[modifier]
    name = held.node_group.interface.items_tree[socket].identifier
    value = f".properties.inputs.{name}.value" if hasattr(held, "properties") else f'["{name}"]'
    path = f'modifiers["{modifier}"]{value}'
    curve = _drive(item, path, f"clamp(time, {root[FIRST]}, {root[LAST]})", root, time=TIME)
    if times is not None:
        write_keys(curve, times, np.arange(len(times)))


def _drive_presence(root: bpy.types.Object, item: bpy.types.Object) -> None:
    """Let the modifier by which Gaussians come and go follow Time."""
    if PRESENCE in item.modifiers:
        drive_input(root, item, PRESENCE, "Time")


def _follow(root: bpy.types.Object) -> None:
    _drive(root, _path(TIME), FOLLOWING, root, first=FIRST, start=START, rate=RATE)


def _drive(
    datablock: bpy.types.ID, path: str, expression: str, root: bpy.types.Object, **variables: str
) -> bpy.types.FCurve:
    """Drive a property by an expression of properties of the root, one that Blender works out without Python."""
    drivers = datablock.animation_data_create().drivers
    if (old := drivers.find(path)) is not None:
        drivers.remove(old)
    curve = _new_driver(drivers, path, 0)
    curve.driver.type, curve.driver.expression = "SCRIPTED", expression
    for name, source in variables.items():
        _add_variable(curve.driver, name, root, source)
    return curve


def _new_driver(drivers, path: str, index: int) -> bpy.types.FCurve:
    """Return a driver without keys: Blender gives it two, which would change its value."""
    curve = drivers.new(path, index=index)
    while curve.keyframe_points:
        curve.keyframe_points.remove(curve.keyframe_points[0], fast=True)
    return curve


def _add_variable(driver: bpy.types.Driver, name: str, root: bpy.types.Object, source: str) -> None:
    variable = driver.variables.new()
    variable.name = name
    variable.targets[0].id, variable.targets[0].data_path = root, _path(source)


def _look_up(root: bpy.types.Object, on: bool) -> None:
    """Add the drivers that look up Time beside the keys below a root, or remove them."""
    timing = timing_of(root)
    for datablock in _datablocks(root):
        curves = curves_of(datablock)
        drivers = datablock.animation_data_create().drivers if curves else ()
        for curve in curves or ():
            old = drivers.find(curve.data_path, index=curve.array_index)
            if on and old is None:
                new = _new_driver(drivers, curve.data_path, curve.array_index)
                new.driver.type = "AVERAGE"
                _add_variable(new.driver, "time", root, TIME)
                copy_keys(curve, new)
                move_keys(new, lambda frames: _snapped(timing.times_at(frames)))
            elif not on and old is not None and old.driver.type == "AVERAGE":
                drivers.remove(old)
    root[LOOKED_UP] = on


def _snapped(times: np.ndarray) -> np.ndarray:
    """Return the times, with those near a whole clip frame put on it."""
    whole = np.round(times)
    return np.where(np.abs(times - whole) < NEAR, whole, times)


def _datablocks(root: bpy.types.Object) -> list[bpy.types.ID]:
    """Return the objects below a root and their data; not those of another scene that hangs there."""
    below = root.children_recursive
    others = {part for item in below if TIME in item for part in (item, *item.children_recursive)}
    mine = [item for item in below if item not in others]
    return [*mine, *dict.fromkeys(item.data for item in mine if item.data is not None)]


def _animated(root: bpy.types.Object) -> list[bpy.types.ID]:
    """Return the objects and data with an action below a root."""
    return [item for item in _datablocks(root) if item.animation_data and item.animation_data.action]


def _own_curves(root: bpy.types.Object) -> list[bpy.types.FCurve]:
    """Return the F-curves of everything below a root, in actions of its own: copies share them at first."""
    animated = _animated(root)
    users: dict[bpy.types.Action, list[bpy.types.ID]] = {}
    for item in animated:
        users.setdefault(item.animation_data.action, []).append(item)
    for action, items in users.items():
        if action.users - action.use_fake_user > len(items):
            own = action.copy()
            for item in items:
                slot = item.animation_data.action_slot.identifier
                item.animation_data.action = own
                item.animation_data.action_slot = own.slots[slot]
    # objects may share a slot
    found = {(item.animation_data.action, item.animation_data.action_slot_handle): item for item in animated}
    return [curve for item in found.values() for curve in curves_of(item) or ()]


def _time_curve(root: bpy.types.Object) -> bpy.types.FCurve | None:
    """Return the keys of Time."""
    curves = curves_of(root)
    return None if curves is None else curves.find(_path(TIME))


def _is_own(root: bpy.types.Object) -> bool:
    """Return True if a root is not another file's."""
    return root.library is None and root.override_library is None


def _path(name: str) -> str:
    return f'["{name}"]'


@persistent
def _changed(scene: bpy.types.Scene, *_) -> None:
    for root in [item for item in scene.objects if TIME in item and _is_own(item)]:
        keep(root)


@persistent
def _file_loaded(*_) -> None:
    _held.clear()
    _changed(bpy.context.scene)


@persistent
def _undone(*_) -> None:
    """Put right keys and drivers that were changed after a step of undo, by `_changed`, and that undo has not brought back."""
    for root in [item for item in bpy.context.scene.objects if TIME in item and _is_own(item)]:
        actions = {item.animation_data.action for item in _animated(root)}
        if any(tuple(action.get(PLACED, root[PLACED])) != tuple(root[PLACED]) for action in actions):
            _place_keys(root)
        _look_up(root, root[LOOKED_UP])


HANDLERS = {
    "depsgraph_update_pre": _changed,
    "frame_change_pre": _changed,
    "undo_post": _undone,
    "redo_post": _undone,
    "load_post": _file_loaded,
}
