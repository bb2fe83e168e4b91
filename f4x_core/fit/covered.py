"""What always stood behind something that moves gets the colours of what is seen around it.

No frame shows such static Gaussians, but for what shines through the edges of the thing before them, and a fit paints them with
its colours: seen from the side, or without the thing, they are its ghost. Filling from the surroundings is what inpainting by
diffusion does (Bertalmio et al., "Image Inpainting", 2000), here among Gaussians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.arrays import evenly_spaced
from ..raster.blend_weights import blend_weight_sums
from ..scene import Scene, StaticSet

VIEWS, COLUMNS = 32, 240
"""Views, evenly over the clip, in which blend weights are summed, and their width in pixels."""
COVERED, CLEAR = 0.35, 0.7
"""Fractions of its light, without what moves, that reach a view: of what is covered less does in every view, what lends its
colours shows more in some view. Pictures along the path of eight filmed clips change by 0 to .03 dB; with .5 train loses .16 dB,
because what comes to light for a moment is painted over."""
SEEN = 0.1
"""Least blend weight, in pixels of a view, of a Gaussian of which that view tells."""
NEIGHBOURS = 12
"""Gaussians that lend theirs to one, by nearness as the camera in the middle of the clip sees them."""
FAR = 0.2
"""Weight of the logarithm of a distance beside a direction (1 = a radian): depth is known less well than place in the picture."""
CLOSE = 1e-4
"""Added to distances, so that one neighbour at the same place does not decide alone."""


def painted(scene: Scene) -> StaticSet:
    """The static Gaussians of a fitted scene; those that what moves covers in all views have the colours of their neighbours."""
    static = scene.static
    if not scene.moving.any() or not len(static.ids):
        return static
    shown, seen = _shown(scene)
    covered, clear = seen & (shown < COVERED), seen & (shown > CLEAR)
    if not covered.any() or not clear.any():
        return static
    sights = _sights(scene)
    near = min(NEIGHBOURS, int(clear.sum()))
    distance, index = cKDTree(sights[clear]).query(sights[covered], k=range(1, near + 1))
    weight = 1 / (distance + CLOSE)
    weight /= weight.sum(1, keepdims=True)
    colours = static.sh.copy()
    colours[covered] = np.einsum("nk,nkcd->ncd", weight, static.sh[clear][index])
    return replace(static, sh=colours)


def _shown(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Of the S static Gaussians: (S,) the greatest fraction of its light that reaches a view, (S,) bool whether any view tells."""
    cameras, still = scene.cameras, replace(scene, dynamic=scene.dynamic.empty(), scaffold=None)
    layer = np.ones((max(1, round(COLUMNS * cameras.height / cameras.width)), COLUMNS, 1), np.float32)
    shown, seen = np.zeros(len(scene.static.ids)), np.zeros(len(scene.static.ids), bool)
    for frame in evenly_spaced(len(cameras), VIEWS):
        camera, time = cameras[int(frame)].resized(COLUMNS, len(layer)), float(cameras.times[frame])
        alone = blend_weight_sums(still.posed(time), camera, layer)[:, 0]
        reaches = blend_weight_sums(scene.posed(time), camera, layer)[: len(shown), 0]  # static ones come first
        tells = alone > SEEN
        shown[tells] = np.maximum(shown[tells], reaches[tells] / alone[tells])
        seen |= tells
    return shown, seen


def _sights(scene: Scene) -> np.ndarray:
    """(N,4): directions in which the camera in the middle of the clip sees the static Gaussians, and their weighed distance."""
    away = scene.static.means - scene.cameras[len(scene.cameras) // 2].center
    far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.concatenate([away / far, FAR * np.log(far)], 1)
