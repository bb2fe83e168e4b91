"""Which Gaussians no frame of the clip shows: where one of them comes to light, a picture shows what nobody has seen."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..geometry.camera import Camera
from ..scene import MADE_UP, Scene
from ..scene.clouds import Cloud, fitted_config
from .blend_weights import Look, seen_sums
from .pixels import coverage_by

VIEWS, COLUMNS = 32, 320
"""Frames, evenly over the clip, that are looked at, and the width of their pictures: what is seen is seen for more than a frame,
and on more than a pixel."""

LEAST = 1 / 255
"""Fraction of a Gaussian's light that has to reach a frame for that to show it: less is no step of eight bits. Layers that shine
faintly through a surface are part of it; behind what is opaque a thousandth is left."""

_UNSEEN: WeakKeyDictionary[Scene, np.ndarray] = WeakKeyDictionary()


def unseen_gaussians(scene: Scene) -> np.ndarray:
    """Return the Gaussians (N,) bool of `scene.posed` whose light reaches no frame of the clip before any edit (`LEAST`).

    What a fit made up is among them, though edges of what moves let some of it through. Copies are what their originals are.
    Cached for the lifetime of the scene before its edits.
    """
    base = scene.base
    if base not in _UNSEEN:
        unseen = ~_seen(base)
        unseen[: len(base.static)] |= base.extra.get(MADE_UP, False)
        _UNSEEN[base] = unseen
    return _UNSEEN[base][scene.origin]


def unseen_image(scene: Scene, camera: Camera, time: float, backend: str = "auto") -> np.ndarray:
    """Return (H,W) float32 in [0, 1]: the pass `unseen` of `scene.stage.draw`, of one scene without surfaces."""
    return 1 - coverage_by(scene, ~unseen_gaussians(scene), camera, time, backend)


def _seen(scene: Scene) -> np.ndarray:
    """Return the Gaussians (N,) bool that some view shows."""
    cameras = scene.cameras
    seen = np.zeros(len(scene.ids), bool)
    for frame in evenly_spaced(len(cameras), VIEWS):
        time, camera = float(cameras.times[frame]), cameras[frame].of_width(COLUMNS)
        nothing = np.zeros((camera.height, camera.width, 0), np.float32)
        cloud = Cloud.of_scene(scene, time)
        look = Look(cloud.shape, camera, fitted_config([cloud], camera))
        seen |= seen_sums(look, nothing, LEAST, among=~seen)[1]
    return seen
