"""How much light each Gaussian sends into parts of a picture: from masks in pixels to scores of Gaussians.

The picture is linear in the colours, `I_p = sum_g w_gp c_g`, so the gradient of `sum_p m_p I_p` with respect to the colour of
Gaussian g is `sum_p m_p w_gp`: the light that g sends into the mask m. One backward pass gives it for all Gaussians.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..progress import Progress, silent
from ..scene import Scene


def light_into(scene: Scene, time: float, index: int | None, layers: np.ndarray) -> np.ndarray:
    """(N,L) float32: light in pixels of every Gaussian, static first, into `layers (H,W,L)` at clip time `time`.

    Seen from the camera at `time`, or from the clip's camera number `index`; its pictures are scaled to the size of the layers.
    """
    from ..raster import RasterConfig
    from ..raster.native import available

    path = scene.cameras
    height, width = layers.shape[:2]
    camera = (path.at(time) if index is None else path[index]).resized(width, height)
    posed = scene.posed(time)
    inputs = {
        "means": posed.means,
        "quats": posed.quats,
        "scales": posed.scales,
        "opacities": posed.opacities,
        "colors": np.zeros((len(posed.ids), layers.shape[2]), np.float32),
        "viewmat": camera.world_to_camera.astype(np.float32),
        "K": camera.intrinsics.astype(np.float32),
    }
    layers = np.ascontiguousarray(layers, np.float32)
    if available():
        from ..raster.native import library as native

        library, _ = native.open_library()
        assert library is not None
        drawn = native.forward(library, inputs, width, height, RasterConfig(), 0, keep=True)
        return native.backward(library, drawn, layers, None, None)["colors"]
    import torch

    from ..raster import rasterize

    tensors: dict[str, Any] = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in inputs.items()}
    colors = tensors["colors"].requires_grad_()
    rasterize(**tensors, width=width, height=height, backend="torch").channels.backward(torch.from_numpy(layers))
    assert colors.grad is not None
    return colors.grad.numpy()


def lift_masks(
    scene: Scene, masks: Mapping[int, np.ndarray], progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray]:
    """(share (N,) in [0, 1], light (N,) in pixels) of every Gaussian's light that falls inside `masks`, all frames together.

    `masks`: clip frame -> (H,W) shares in [0, 1], of any size. The share is 0 where the light is.
    """
    inside, total = (np.zeros(len(scene.static) + len(scene.dynamic), np.float64) for _ in range(2))
    for done, (frame, mask) in enumerate(masks.items()):
        progress("light", done, len(masks))
        mask = np.asarray(mask, np.float32)
        light = light_into(scene, float(scene.cameras.times[frame]), frame, np.stack([mask, np.ones_like(mask)], -1))
        inside += light[:, 0]
        total += light[:, 1]
    progress("light", len(masks), len(masks))
    return np.clip(inside / np.maximum(total, 1e-12), 0, 1) * (total > 0), total
