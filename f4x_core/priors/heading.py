"""Turn of long moving objects against the view, by the way they go: animals and vehicles move along their length.

Contact with the ground tells little of it: feet are few, masks lack them, and bellies and tails hang over farther ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.camera import CameraPath

WINDOW = 12
"""Frames before and after a frame over which its way is taken: half a second."""
SHOWN = 0.75
"""Fraction of the relief along the way that a body shows in the mean: its end is seen beside its flank."""
MAX_RELIEF = 0.3
"""Largest change of inverse depth across a body, as a fraction."""
HALF_WAY = 0.25
"""Way within the window, in widths of the body, at which the heading counts by half: a shorter one is noise of the distance."""
LONG = (1.0, 1.5)
"""Width over height (median over time) up to which a body has no long side to turn, and from which on it has."""


@dataclass(frozen=True)
class Extents:
    """Places and sizes of one object in f frames, pixels."""

    center: np.ndarray
    """(f, 2) mean pixel x, y."""
    size: np.ndarray
    """(f, 2) width and height."""

    @classmethod
    def of(cls, masks: Sequence[np.ndarray] | np.ndarray) -> Extents:
        """Return those of `masks (f, H, W)` bool, none of which is empty."""
        places = [np.nonzero(mask)[::-1] for mask in masks]
        center = [[x.mean() + 0.5, y.mean() + 0.5] for x, y in places]
        return cls(np.array(center), np.array([[np.ptp(x) + 1.0, np.ptp(y) + 1.0] for x, y in places]))

    @property
    def length(self) -> float:
        """0..1: how far the object is long rather than high."""
        ratio = float(np.median(self.size[:, 0] / self.size[:, 1]))
        return float(np.clip((ratio - LONG[0]) / (LONG[1] - LONG[0]), 0, 1))


def turn_along_way(extents: Extents, inverse: np.ndarray, cameras: CameraPath) -> np.ndarray:
    """Return `(f,)` the relative change per column of an object's inverse depth, that of an upright plane along its way.

    `inverse (f,)` is its inverse depth in the frames of `cameras`. 0 where it hardly moves and for what is no longer than high.
    """
    length = extents.length
    if len(inverse) < 3 or not length:
        return np.zeros(len(inverse))
    every = [cameras[i] for i in range(len(cameras))]
    placed = zip(every, extents.center, 1 / inverse, strict=True)
    places = np.concatenate([camera.unproject(at[None], depth[None]) for camera, at, depth in placed])
    down, times, turns = cameras.mean_down, cameras.times, np.zeros(len(inverse))
    for i, (camera, at, width) in enumerate(zip(every, extents.center, extents.size[:, 0], strict=True)):
        near = abs(times - times[i]) <= WINDOW
        speed = _slope(times[near] - times[i], places[near])
        way = np.linalg.norm(speed) * np.ptp(times[near])
        focal = float(camera.intrinsics[0, 0])
        ray = np.append(camera.on_plane(at), 1.0)
        normal = camera.world_to_camera[:3, :3] @ np.cross(speed, down)
        facing = normal @ ray
        if not abs(facing) > 0:
            continue
        relief = np.clip(SHOWN * normal[0] / (focal * facing) * width, -MAX_RELIEF, MAX_RELIEF)
        widths = way / (width / focal / inverse[i])
        turns[i] = length * widths**2 / (widths**2 + HALF_WAY**2) * relief / width
    return turns


def _slope(times: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the `(3,)` world units per frame of the straight line through `places (n, 3)` at `times (n,)`; 0 of one place."""
    centred = times - times.mean()
    return centred @ places / max(float(centred @ centred), 1e-9)
