"""Who is left of a scene after its edits: what was deleted stays as rows of opacity 0, and no query may mean it."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import Scene

MOMENTS = 16
"""Clip frames, evenly over the clip, at which an edited scene is looked at: edits may delete for a time only."""

_STANDING: WeakKeyDictionary[Scene, np.ndarray] = WeakKeyDictionary()


def standing(scene: Scene) -> np.ndarray:
    """(N,) bool over `scene.posed`: Gaussians whose opacity is above 0 at some moment. Kept as long as the scene lives."""
    if scene.base is scene:
        return np.ones(len(scene.ids), bool)  # before edits nothing is deleted
    if scene not in _STANDING:
        there = np.zeros(len(scene.ids), bool)
        times = scene.cameras.times
        looked = [times[evenly_spaced(len(times), MOMENTS)]]
        # who comes and goes is looked at when it is there in full
        looked += [part.span[:, 1:3].ravel() for part in (scene.static, scene.dynamic) if part.span is not None]
        for time in np.unique(np.clip(np.concatenate(looked), times[0], times[-1])):
            there |= scene.posed(float(time)).opacities > 0
            if there.all():
                break
        _STANDING[scene] = there
    return _STANDING[scene]
