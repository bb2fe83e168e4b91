"""Which Gaussians of an edited scene are not deleted. Deleted ones stay as rows of opacity 0, and no query may select them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import Scene

CHECKED_FRAMES = 16
"""Clip frames, evenly over the clip, at which the opacities of an edited scene are checked: an edit can delete for a time only."""

_NOT_DELETED: WeakKeyDictionary[Scene, np.ndarray] = WeakKeyDictionary()


def not_deleted(scene: Scene) -> np.ndarray:
    """(N,) bool over `scene.posed`: Gaussians whose opacity is above 0 at some moment. Cached for the scene's lifetime."""
    if scene.base is scene:
        return np.ones(len(scene.ids), bool)  # before edits nothing is deleted
    if scene not in _NOT_DELETED:
        visible = np.zeros(len(scene.ids), bool)
        times = scene.cameras.times
        checked = [times[evenly_spaced(len(times), CHECKED_FRAMES)]]
        # Gaussians with a limited life span are checked while they are fully visible
        checked += [part.span[:, 1:3].ravel() for part in (scene.static, scene.dynamic) if part.span is not None]
        for time in np.unique(np.clip(np.concatenate(checked), times[0], times[-1])):
            visible |= scene.posed(float(time)).opacities > 0
            if visible.all():
                break
        _NOT_DELETED[scene] = visible
    return _NOT_DELETED[scene]
