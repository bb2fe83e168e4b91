"""The `gsplat` backend: our projection, and the tile kernels of the package gsplat (nerfstudio) on a CUDA device.

Only three of gsplat's functions are used, with the meaning they have since gsplat 1.5: `isect_tiles`, `isect_offset_encode` and
`rasterize_to_pixels`. Their constants are compiled in: alpha is clamped to 0.999 there, so where a splat is more opaque
than `RasterConfig.alpha_max` this backend differs from the others.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import F4xError
from .contract import RasterConfig, RasterInput, RasterOutput
from .projection import project
from .tiles import add_background

TILE = 16
"""Side of gsplat's tiles in pixels."""
CHANNELS = 32
"""Channels composited at a time, gsplat's own habit: more do not fit a block's shared memory on every device."""


def rasterize_gsplat(inputs: RasterInput) -> RasterOutput:
    """Composite Gaussians, float32 tensors on a CUDA device only; see `rasterize`.

    Raises:
        F4xError: other dtypes or devices, or an alpha cut or stop that gsplat does not have.
    """
    _check(inputs.splats.means, inputs.config)
    width, height = inputs.camera.width, inputs.camera.height
    ellipses = project(inputs.splats, inputs.camera, inputs.config, inputs.mean2d_offset)
    x, y, a, slope, r, _ = ellipses.table
    mean2d = torch.stack((x, y), 1)[None]  # (1, N, 2): gsplat takes a batch of images
    conic = torch.stack((a, -a * slope, a * slope * slope + r), 1)[None]  # (1, N, 3) upper triangle
    features = torch.cat((ellipses.depth[:, None], inputs.colors), 1)[None]  # (1, N, 1 + C)
    attached = 1 + inputs.attached_channels
    lists = _build_lists(mean2d, ellipses.half_box, ellipses.visible, ellipses.depth, width, height)

    shape = (mean2d, conic, inputs.splats.opacities[None])
    first, alpha = _composite(shape, features[..., :attached], lists, width, height)
    rest, _ = _composite(tuple(t.detach() for t in shape), features[..., attached:], lists, width, height)
    channels = add_background(inputs, torch.cat((first[..., 1:], rest), -1), alpha)
    return RasterOutput(channels, first[..., 0], alpha, ellipses.visible)


def _check(means: Tensor, config: RasterConfig) -> None:
    if means.dtype != torch.float32 or means.device.type != "cuda":
        raise F4xError(
            f"The gsplat raster backend takes float32 tensors on a CUDA device, these are {means.dtype} on "
            f"{means.device}: use backend='torch'."
        )
    own = RasterConfig()
    if (config.alpha_min, config.transmittance_min) != (own.alpha_min, own.transmittance_min):
        raise F4xError("The gsplat raster backend has a fixed alpha_min and transmittance_min: use backend='torch'.")


def _build_lists(
    mean2d: Tensor, half_box: Tensor, visible: Tensor, depth: Tensor, width: int, height: int
) -> tuple[Tensor, Tensor]:
    """Return offsets (1, tile rows, tile columns) and splat ids, tile after tile, front to back; none of radius 0."""
    from gsplat import isect_offset_encode, isect_tiles

    columns, rows = -(-width // TILE), -(-height // TILE)
    radii = torch.where(visible, half_box.ceil(), 0).t().int()[None]  # (1, N, 2)
    _, keys, ids = isect_tiles(mean2d.detach(), radii, depth.detach()[None], TILE, columns, rows)
    return isect_offset_encode(keys, 1, columns, rows), ids


def _composite(
    shape: tuple[Tensor, ...], features: Tensor, lists: tuple[Tensor, Tensor], width: int, height: int
) -> tuple[Tensor, Tensor]:
    """Return features (H, W, F) and alpha (H, W) of splats (mean2d, conic, opacities); no alpha where there is no feature."""
    from gsplat import rasterize_to_pixels

    images, alpha = [features.new_empty(height, width, 0)], features.new_empty(0)
    for part in features.split(CHANNELS, -1) if features.shape[-1] else ():
        mean2d, conic, opacities = shape
        image, light = rasterize_to_pixels(mean2d, conic, part, opacities, width, height, TILE, *lists)
        images.append(image[0])
        alpha = light[0, ..., 0]
    return torch.cat(images, -1), alpha
