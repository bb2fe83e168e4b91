"""How much light each Gaussian sends into parts of a picture: from masks in pixels to scores of Gaussians."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..progress import Progress, silent
from ..raster import light as raster_light
from ..scene import Scene


def light_into(scene: Scene, time: float, index: int | None, layers: np.ndarray) -> np.ndarray:
    """(N,L) float32: light in pixels of every Gaussian, static first, into `layers (H,W,L)` at clip time `time`.

    Seen from the camera at `time`, or from the clip's camera number `index`; its pictures are scaled to the size of the layers.
    """
    path = scene.cameras
    height, width = layers.shape[:2]
    camera = (path.at(time) if index is None else path[index]).resized(width, height)
    posed = scene.posed(time)
    shapes = (posed.means, posed.quats, posed.scales, posed.opacities)
    return raster_light.light_into(*shapes, camera.world_to_camera, camera.intrinsics, layers)


def lift_masks(
    scene: Scene, masks: Mapping[int, np.ndarray], progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray]:
    """(share (N,) in [0, 1], light (N,) in pixels) of every Gaussian's light that falls inside `masks`, all frames together.

    `masks`: clip frame -> (H,W) shares in [0, 1], of any size. The share is 0 where the light is.
    """
    inside, total = (np.zeros(len(scene.ids), np.float64) for _ in range(2))
    for done, (frame, mask) in enumerate(masks.items()):
        progress("light", done, len(masks))
        mask = np.asarray(mask, np.float32)
        light = light_into(scene, float(scene.cameras.times[frame]), frame, np.stack([mask, np.ones_like(mask)], -1))
        inside += light[:, 0]
        total += light[:, 1]
    progress("light", len(masks), len(masks))
    return np.clip(inside / np.maximum(total, 1e-12), 0, 1) * (total > 0), total
