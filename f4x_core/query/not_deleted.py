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
    """Return the Gaussians (N,) bool of `scene.posed` whose opacity is above 0 at some moment, even one that retiming hides.

    Cached for the scene's lifetime.
    """
    if scene.base is scene:
        return np.ones(len(scene.ids), bool)  # before edits nothing is deleted
    if scene.untimed is not scene:
        return not_deleted(scene.untimed)
    if scene not in _NOT_DELETED:
        times = scene.cameras.times
        visible = _seen_at(scene, times[evenly_spaced(len(times), CHECKED_FRAMES)], np.zeros(len(scene.ids), bool))
        if scene.fades:  # what lives between those frames only is checked while it is fully there
            visible = _seen_at(scene, _lively_moments(scene, ~visible & ~scene.gone), visible)
        _NOT_DELETED[scene] = visible
    return _NOT_DELETED[scene]


def _seen_at(scene: Scene, times: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return `visible (N,)` with those that have opacity at one of `times`; it stops where nothing is left to be seen."""
    for time in times:
        if (visible | scene.gone).all():
            break
        visible = visible | (scene.posed(float(time)).opacities > 0)
    return visible


def _lively_moments(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Return the fewest times at which each Gaussian of `rows (N,)` is fully present, early in its life and late."""
    parts = (scene.base.static, scene.base.dynamic)
    spans = [np.full((len(part), 4), np.inf) * (-1, -1, 1, 1) if part.span is None else part.span for part in parts]
    clip = scene.cameras.times[0], scene.cameras.times[-1]
    start, end = np.clip(np.concatenate(spans)[scene.origin[rows], 1:3], *clip).T
    return np.unique(np.concatenate([_within_each(start, end), -_within_each(-end, -start)]))


def _within_each(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the fewest numbers so that each interval from `start (n,)` to `end (n,)` holds one: ends of some of them."""
    found: list[float] = []
    for i in np.argsort(end):
        if not found or start[i] > found[-1]:
            found.append(float(end[i]))
    return np.array(found)
