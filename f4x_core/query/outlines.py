"""The Gaussians of a thing that moves, by its outlines as views of the clip show them. Needs numpy alone.

Superpoints and features end softly: the ground between legs, a shadow or ripples come along with a thing, and an edit of it would
show there. Its mattes are refined in some views (`matte`), and each Gaussian goes where most of it lies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..clip.images import resize_nearest
from ..geometry.arrays import evenly_spaced
from ..geometry.trajectory import View
from ..raster.blend_weights import BlendWeights
from ..scene import Scene
from ..scene.view import render
from .blend_weights import view_size
from .kept import Kept
from .matte import background_of, refine_matte
from .objects import MOSTLY
from .segmentation import shrink
from .select_config import SELECT, OutlineConfig, SelectConfig


class Shown(NamedTuple):
    """A view of a scene's clip."""

    view: View
    """Its camera and time."""
    picture: np.ndarray
    """(h,w,3) float32 sRGB of all of it."""
    background: np.ndarray
    """(h,w,4) float32 sRGB and alpha of what does not move."""
    seen: np.ndarray
    """(N,) float32: blend weights in the picture, in pixels of the larger one in which masks are lifted."""


_SHOWN: Kept[dict[int, Shown]] = Kept()


def within_outlines(
    scene: Scene, scores: np.ndarray, threshold: float = MOSTLY, config: SelectConfig = SELECT, adds: bool = True
) -> np.ndarray:
    """Return `scores (N,)` of a thing that moves, 0 for Gaussians mostly outside of its refined outlines, 1 for moving ones inside.

    Gaussians that the views hardly show keep theirs; so do all of a thing that mostly stands, or of which most would be lost.
    Outlines are those before edits; a copy goes with its original, and where copies are meant, or without `adds`, none is
    added.
    """
    base, copies = scene.base, np.arange(len(scene.ids)) >= len(scene.base.ids)
    meant = (scores >= threshold) & (scores > 0)
    chosen = np.zeros(len(base.ids), bool)
    chosen[scene.origin[meant]] = True
    moves = chosen[base.moving].sum() > MOSTLY * chosen.sum()
    found = _found(base, chosen, config.outline) if moves else chosen
    lost, added = ((one & ~other)[scene.origin] for one, other in ((chosen, found), (found, chosen)))
    scores = np.where(meant & lost, 0, scores)
    return scores if meant[copies].any() or not adds else np.where(added & ~copies, 1, scores)


def _found(scene: Scene, chosen: np.ndarray, config: OutlineConfig) -> np.ndarray:
    """Return (N,) bool: the Gaussians of the thing that `chosen (N,)` bool show, by its outlines; `chosen` if most are lost."""
    (high, wide), size = view_size(scene, config.lifted), view_size(scene, config.columns)
    views = [(shown, _weights(scene, shown.view, (high, wide))) for shown in views_of_outlines(scene, config).values()]
    total = np.sum([shown.seen for shown, _ in views], 0, dtype=float)
    found = chosen
    for _ in range(config.rounds):
        inside = np.zeros(len(chosen))
        for shown, weights in views:
            coverage = shrink(weights.picture(found[:, None])[..., 0], size)
            matte = refine_matte(np.clip(coverage, 0, 1), shown.picture, shown.background, config.matte)
            inside += weights.sums(resize_nearest(matte, wide, high)[..., None])[:, 0]
        found = np.where(total > config.seen, (inside > MOSTLY * total) & (scene.moving | chosen), found)
        lost = total[chosen & ~found].sum() > MOSTLY * total[chosen].sum()
        if lost:  # a shadow that was meant, or a thing like its background
            return chosen
    return found


def views_of_outlines(scene: Scene, config: OutlineConfig = SELECT.outline) -> dict[int, Shown]:
    """Return clip frame -> view for the views in which outlines are looked at, kept as long as the scene lives."""
    return _SHOWN.get(scene.static, scene.dynamic, config, make=lambda: _views(scene, config))


def _views(scene: Scene, config: OutlineConfig) -> dict[int, Shown]:
    """Return clip frame -> view."""
    cameras, (height, width) = scene.cameras, view_size(scene, config.columns)
    size, shown = view_size(scene, config.lifted), {}
    for frame in evenly_spaced(len(cameras), config.views, ends=False).tolist():
        view = View(cameras[frame].resized(width, height), float(cameras.times[frame]))
        seen = _weights(scene, view, size).sums(np.ones((*size, 1), np.float32))[:, 0]
        shown[frame] = Shown(view, render(scene, *view, ("rgb",))["rgb"], background_of(scene, view), seen)
    return shown


def _weights(scene: Scene, view: View, size: tuple[int, int]) -> BlendWeights:
    """Return the blend weights of the Gaussians in the picture (H,W) = `size` of a view."""
    return BlendWeights(scene.posed(view.time), view.camera.resized(size[1], size[0]), 1)
