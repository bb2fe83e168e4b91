"""How much each Gaussian weighs in parts of a picture: from masks in pixels to scores of Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..progress import Progress, silent
from ..raster import RasterConfig, blend_weights
from ..scene import Scene

MARGIN = 0.25
"""Of a picture's sides, added on each of them: what the picture cuts is as visible as what it shows whole."""


def blend_weight_sums(scene: Scene, time: float, index: int | None, layers: np.ndarray) -> np.ndarray:
    """Return (N,L) float32: blend weights of every Gaussian, static first, summed over `layers (H,W,L)` at clip time `time`.

    Seen from the camera at `time`, or from the clip's camera number `index`; its pictures are scaled to the size of the layers.
    """
    path = scene.cameras
    height, width = layers.shape[:2]
    camera = (path.at(time) if index is None else path[index]).resized(width, height)
    return blend_weights.blend_weight_sums(scene.posed(time), camera, layers)


@dataclass(frozen=True)
class Look:
    """Gaussians seen from a camera, and how they are drawn."""

    splats: Splats
    camera: Camera
    config: RasterConfig
    backend: str = "auto"


def seen_sums(
    look: Look, layers: np.ndarray, least: float, among: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return (sums (N,L) float64 of blend weights in `layers (H,W,L)`, (N,) bool of the Gaussians that show in the picture).

    A Gaussian shows if some of its light falls into the picture, and of all its light, on a picture that is wider by `MARGIN`,
    at least the fraction `least` passes what is before it. Only those of `among (N,) bool` are looked at for that.
    """
    rows, columns = (round(MARGIN * size) for size in layers.shape[:2])
    camera, config = look.camera, look.config
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] += columns, rows
    wide = Camera(intrinsics, camera.world_to_camera, camera.width + 2 * columns, camera.height + 2 * rows)
    inside = np.concatenate([layers, np.ones((*layers.shape[:2], 1), np.float32)], -1)
    inside = np.pad(inside, ((rows, rows), (columns, columns), (0, 0)))
    all_of_it = np.concatenate([inside, np.ones((*inside.shape[:2], 1), np.float32)], -1)
    sums = blend_weights.blend_weight_sums(look.splats, wide, all_of_it, config=config, backend=look.backend)
    found = sums.astype(np.float64)
    seen = found[:, -2] > 0 if among is None else among & (found[:, -2] > 0)
    index = np.flatnonzero(seen)
    seen[index] = found[index, -1] >= least * blend_weights.alpha_sums(look.splats.take(index), wide, config=config)
    return found[:, :-2], seen


def total_blend_weights(scene: Scene, views: int, columns: int) -> np.ndarray:
    """Return (N,) float64: blend weights in pixels, summed over at most `views` views of the clip, `columns` wide."""
    return sums_over_views(scene, views, columns, lambda frame, size: np.ones((*size, 1), np.float32))[:, 0]


def view_size(scene: Scene, columns: int) -> tuple[int, int]:
    """Return (h,w) of the clip's pictures drawn `columns` wide."""
    return max(1, round(columns * scene.cameras.height / scene.cameras.width)), columns


def sums_over_views(
    scene: Scene, views: int, columns: int, draw: Callable[[int, tuple[int, int]], np.ndarray]
) -> np.ndarray:
    """Return (N,L) float64: `blend_weight_sums`, summed over at most `views` views of the clip, `columns` wide.

    `draw` gives the layers (h,w,L) of a clip frame at the size (h,w) of a view (`view_size`).
    """
    cameras, total = scene.cameras, np.zeros((len(scene.ids), 1))
    size = view_size(scene, columns)
    for frame in map(int, evenly_spaced(len(cameras), views)):
        total = total + blend_weight_sums(scene, float(cameras.times[frame]), frame, draw(frame, size))
    return total


def lift_masks(
    scene: Scene, masks: Mapping[int, np.ndarray], progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fraction (N,) in [0, 1] of every Gaussian's blend weights inside `masks`, and their sum (N,) in pixels.

    `masks`: clip frame -> (H,W) fractions in [0, 1], of any size. The fraction is 0 where the sum is.
    """
    inside, total = (np.zeros(len(scene.ids), np.float64) for _ in range(2))
    for done, (frame, mask) in enumerate(masks.items()):
        progress("weights", done, len(masks))
        mask = np.asarray(mask, np.float32)
        sums = blend_weight_sums(
            scene, float(scene.cameras.times[frame]), frame, np.stack([mask, np.ones_like(mask)], -1)
        )
        inside += sums[:, 0]
        total += sums[:, 1]
    progress("weights", len(masks), len(masks))
    return np.clip(inside / np.maximum(total, 1e-12), 0, 1), total
