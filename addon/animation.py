"""Bulk keyframes: one layered Action, one slot per animated datablock."""

from collections.abc import Mapping

import bpy
import numpy as np

_LINEAR = 1  # the value of 'LINEAR' in Keyframe.interpolation, for foreach_set


class ActionWriter:
    """Writes whole F-curves of many datablocks into one Action."""

    def __init__(self, name: str):
        self.action = bpy.data.actions.new(name)
        self._strip = self.action.layers.new("motion").strips.new(type="KEYFRAME")

    def write(self, datablock: bpy.types.ID, frames: np.ndarray, channels: Mapping[str, np.ndarray]) -> None:
        """Key `channels` (data path -> (T,) or (T,C) values) of `datablock` at `frames (T,)`, linear between keys."""
        slot = self.action.slots.new(id_type=datablock.id_type, name=datablock.name)
        curves = self._strip.channelbag(slot, ensure=True).fcurves
        for path, values in channels.items():
            columns = values.T if values.ndim == 2 else values[None]
            for index, column in enumerate(columns):
                curve = curves.new(path, index=index)
                curve.keyframe_points.add(len(frames))
                curve.keyframe_points.foreach_set("co", np.stack([frames, column], 1).astype(np.float32).ravel())
                curve.keyframe_points.foreach_set("interpolation", np.full(len(frames), _LINEAR, np.int32))
                curve.update()
        data = datablock.animation_data_create()
        data.action = self.action
        data.action_slot = slot
