"""Bulk keyframes: an Action for each animated datablock; reading and replacing them."""

from collections.abc import Callable, Mapping, Sequence

import bpy
import numpy as np
from bpy_extras.anim_utils import action_get_channelbag_for_slot

CONSTANT, LINEAR = 0, 1
"""Values of Keyframe.interpolation, for foreach_set."""
_KEY_FIELDS = {
    np.int32: (("handle_left_type", "handle_right_type", "interpolation", "easing"), 1),
    np.float32: (("co", "handle_left", "handle_right"), 2),
    float: (("back", "amplitude", "period"), 1),
}
"""Type -> names of fields of a keyframe, and their width."""


def write_action(
    datablock: bpy.types.ID, frames: np.ndarray, channels: Mapping[str, np.ndarray], interpolation: int = LINEAR
) -> None:
    """Key `channels` (data path -> (T,) or (T,C) values) of `datablock` at `frames (T,)`, in a new Action of its own.

    Blender copies the whole Action with each object that is copied: one for all nodes took as much as all for each of them.
    """
    action = bpy.data.actions.new(datablock.name)
    strip = action.layers.new("motion").strips.new(type="KEYFRAME")
    slot = action.slots.new(id_type=datablock.id_type, name=datablock.name)
    _write_curves(strip.channelbag(slot, ensure=True).fcurves, frames, channels, interpolation)
    data = datablock.animation_data_create()
    data.action = action
    data.action_slot = slot


def sample(datablock: bpy.types.ID, frames: np.ndarray, paths: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the values (T,C) of vector properties at `frames (T,)` as keyed; what is not keyed stays as it is."""
    curves, found = curves_of(datablock), {}
    for path in paths:
        values = np.tile(np.array(getattr(datablock, path), float), (len(frames), 1))
        for index in range(values.shape[1]):
            curve = curves.find(path, index=index) if curves is not None else None
            if curve is not None:
                values[:, index] = [curve.evaluate(frame) for frame in frames]
        found[path] = values
    return found


def rewrite(datablock: bpy.types.ID, frames: np.ndarray, channels: Mapping[str, np.ndarray]) -> None:
    """Replace all keys of `channels` (data path -> (T,C) values) by keys at `frames (T,)`, linear between them."""
    curves = curves_of(datablock)
    if curves is None:
        write_action(datablock, frames, channels)
        return
    for path in channels:
        for curve in [curve for curve in curves if curve.data_path == path]:
            curves.remove(curve)
    _write_curves(curves, frames, channels, LINEAR)


def curves_of(datablock: bpy.types.ID):
    """Return the F-curves of a datablock; None where it has no keys."""
    data = datablock.animation_data
    if data is None or data.action is None:
        return None
    bag = action_get_channelbag_for_slot(data.action, data.action_slot)
    return None if bag is None else bag.fcurves


def copy_keys(source: bpy.types.FCurve, target: bpy.types.FCurve) -> None:
    """Give an F-curve without keys the keys of another one."""
    keys, copies = source.keyframe_points, target.keyframe_points
    copies.add(len(keys))
    for kind, (names, width) in _KEY_FIELDS.items():
        values = np.empty(width * len(keys), kind)
        for name in names:
            keys.foreach_get(name, values)
            copies.foreach_set(name, values)
    target.extrapolation = source.extrapolation
    target.update()


def write_keys(curve: bpy.types.FCurve, frames: np.ndarray, values: np.ndarray, interpolation: int = LINEAR) -> None:
    """Give an F-curve without keys the `values (T,)` at `frames (T,)`."""
    keys = curve.keyframe_points
    keys.add(len(frames))
    keys.foreach_set("co", np.stack([frames, values], 1).astype(np.float32).ravel())
    keys.foreach_set("interpolation", np.full(len(frames), interpolation, np.int32))
    curve.update()


def move_strips(datablock: bpy.types.ID, moved: Callable[[np.ndarray], np.ndarray]) -> None:
    """Put the NLA strips of a datablock at `moved(frames (n,))`, stretched where that stretches them."""
    for track in datablock.animation_data.nla_tracks if datablock.animation_data else ():
        strips = list(track.strips)
        if strips and moved(np.array([strips[0].frame_start]))[0] > strips[0].frame_start:
            strips.reverse()  # none may run into the next one
        for strip in strips:
            start, end = moved(np.array([strip.frame_start, strip.frame_end])).tolist()
            strip.scale *= (end - start) / (strip.frame_end - strip.frame_start)
            strip.frame_start_ui = start


def move_keys(curve: bpy.types.FCurve, moved: Callable[[np.ndarray], np.ndarray]) -> None:
    """Put the keys of an F-curve, with their handles, at the frames `moved(frames (n,))`, which must increase with `frames`."""
    keys = curve.keyframe_points
    places = np.empty(2 * len(keys), np.float32)
    for name in ("co", "handle_left", "handle_right"):
        keys.foreach_get(name, places)
        places[::2] = moved(places[::2].astype(np.float64))
        keys.foreach_set(name, places)
    curve.update()


def _write_curves(curves, frames: np.ndarray, channels: Mapping[str, np.ndarray], interpolation: int) -> None:
    for path, values in channels.items():
        columns = values.T if values.ndim == 2 else values[None]
        for index, column in enumerate(columns):
            write_keys(curves.new(path, index=index), frames, column, interpolation)
