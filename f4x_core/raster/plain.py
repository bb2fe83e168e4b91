"""The `plain` backend: the rule in numpy alone, in float64 - what draws where neither the compiled library nor torch is.

Tile by tile; of a tile's splats, front to back, a slab at a time meets all pixels of the tile at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..geometry.quaternion import to_matrix
from .contract import FRUSTUM_MARGIN, RasterConfig, RasterInput, RasterOutput

TILE = 8
"""Side of a tile in pixels: most splats are smaller, and what they miss of a tile is work in vain."""
SLAB = 256
"""Splats blended at once: a tile can stop between two slabs."""


class _Splats(NamedTuple):
    """V visible Gaussians, front to back; an exponent is `-(a (dx - slope dy)^2 + c dy^2) / 2`."""

    x: np.ndarray
    y: np.ndarray
    a: np.ndarray
    slope: np.ndarray
    c: np.ndarray
    opacity: np.ndarray
    half_width: np.ndarray
    """Half the width of the box around `alpha >= alpha_min`, pixels."""
    half_height: np.ndarray
    z: np.ndarray
    features: np.ndarray
    """(V, 2 + C): 1, z, colours."""
    row: np.ndarray
    """Rows of the N Gaussians."""

    def take(self, index: np.ndarray | slice) -> _Splats:
        """Return the splats at `index`."""
        return _Splats(*(column[index] for column in self))


def rasterize_plain(inputs: RasterInput) -> RasterOutput:
    """Composite Gaussians, numpy arrays only, results in the dtype of their means; see `rasterize`."""
    rows, width, height = inputs.drawn_rows, inputs.camera.width, inputs.camera.height
    limit = np.full((rows.stop - rows.start, width), np.inf) if inputs.limit is None else inputs.limit
    # Whole tiles: the same sums for any rows.
    above, below = rows.start % TILE, min(-rows.stop % TILE, height - rows.stop)
    limit = np.pad(limit, ((above, below), (0, 0)))
    first, dtype = rows.start - above, inputs.splats.means.dtype
    splats, visible = _project(inputs)
    image = np.zeros((*limit.shape, splats.features.shape[1]))
    for down, across, index in _tiles(splats, width, slice(first, rows.stop + below)):
        here = slice(down.start - first, down.stop - first), across
        tile = image[here]
        for slab, weights in _weights(splats, index, down, across, limit[here], inputs.config):
            tile += (weights.T @ slab.features).reshape(tile.shape)
    image = image[above : len(image) - below].astype(dtype, copy=False)
    alpha, depth, channels = image[..., 0], image[..., 1], image[..., 2:]
    if inputs.background is not None:
        channels = channels + (1 - alpha)[..., None] * inputs.background.astype(dtype, copy=False)
    return RasterOutput(channels, depth, alpha, visible)


def blend_weight_sums_plain(inputs: RasterInput, layers: np.ndarray) -> np.ndarray:
    """Return (N,L) float32: `blend_weights.blend_weight_sums` of `layers (H,W,L)`, whatever the colours of `inputs` are."""
    height, width, count = layers.shape
    splats, _ = _project(replace(inputs, colors=np.zeros((len(inputs.splats), 0))))
    total = np.zeros((len(inputs.splats), count))
    everywhere = np.full((height, width), np.inf)
    for rows, columns, index in _tiles(splats, width, slice(0, height)):
        tile = layers[rows, columns].reshape(-1, count)
        for slab, weights in _weights(splats, index, rows, columns, everywhere[rows, columns], inputs.config):
            total[slab.row] += weights @ tile
    return total.astype(np.float32)


def alpha_sums_plain(inputs: RasterInput) -> np.ndarray:
    """Return (N,) float64: `blend_weights.alpha_sums`."""
    splats, _ = _project(replace(inputs, colors=np.zeros((len(inputs.splats), 0))))
    total = np.zeros(len(inputs.splats))
    total[splats.row] = 2 * np.pi * (splats.opacity - inputs.config.alpha_min) / np.sqrt(splats.a * splats.c)
    return total


def _tiles(splats: _Splats, width: int, drawn: slice) -> Iterator[tuple[slice, slice, np.ndarray]]:
    """Yield (rows, columns, indices of the splats that meet them, front to back) of every tile of the rows `drawn`."""
    for top in range(drawn.start, drawn.stop, TILE):
        rows = slice(top, min(top + TILE, drawn.stop))
        in_row = np.flatnonzero(_meets(splats.y, splats.half_height, rows))
        x, half_width = splats.x[in_row], splats.half_width[in_row]
        for left in range(0, width, TILE):
            columns = slice(left, min(left + TILE, width))
            yield rows, columns, in_row[_meets(x, half_width, columns)]


def _project(inputs: RasterInput) -> tuple[_Splats, np.ndarray]:
    """Return the visible splats front to back, projected as in `reference.project_ewa`, and (N,) bool which those are."""
    config, width, height, offset = inputs.config, inputs.camera.width, inputs.camera.height, inputs.mean2d_offset
    shape = inputs.splats.map(lambda array: np.asarray(array, np.float64))
    means, quats, scales, opacities = shape.means, shape.quats, shape.scales, shape.opacities
    viewmat, K = inputs.camera.world_to_camera, inputs.camera.intrinsics
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    rotation = viewmat[:3, :3]
    x, y, z = (means @ rotation.T + viewmat[:3, 3]).T
    in_front = z > config.near
    z = np.where(in_front, z, 1.0)
    u, v = x / z, y / z
    mean_x, mean_y = u * fx + cx, v * fy + cy
    if offset is not None:
        mean_x, mean_y = mean_x + offset[:, 0], mean_y + offset[:, 1]
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * width / fx, FRUSTUM_MARGIN * 0.5 * height / fy
    u = np.clip(u, -cx / fx - margin_x, (width - cx) / fx + margin_x)
    v = np.clip(v, -cy / fy - margin_y, (height - cy) / fy + margin_y)
    across = (rotation[0] - u[:, None] * rotation[2]) * (fx / z)[:, None]  # (N, 3) rows of J R_cw
    down = (rotation[1] - v[:, None] * rotation[2]) * (fy / z)[:, None]
    M = np.stack([across, down], 1) @ (to_matrix(quats) * scales[:, None])  # (N, 2, 3)
    (xx, xy), (_, yy) = np.moveaxis(M @ M.transpose(0, 2, 1), 0, -1)
    xx, yy = xx + config.blur, yy + config.blur
    minors = (np.cross(M[:, 0], M[:, 1]) ** 2).sum(1)  # no cancellation for needles, unlike xx yy - xy^2
    det = minors + config.blur * (xx + yy) - config.blur**2

    with np.errstate(divide="ignore"):
        reach = 2 * np.maximum(np.log(opacities / config.alpha_min), 0)
    half_width, half_height = np.sqrt(reach * xx), np.sqrt(reach * yy)
    visible = in_front & (opacities >= config.alpha_min)
    visible &= _meets(mean_x, half_width, slice(0, width)) & _meets(mean_y, half_height, slice(0, height))
    features = np.concatenate([np.ones((len(z), 1)), z[:, None], inputs.colors], 1)
    ellipse = (mean_x, mean_y, yy / det, xy / yy, 1 / yy, opacities, half_width, half_height)
    everything = _Splats(*ellipse, z, features, np.arange(len(z)))
    index = np.flatnonzero(visible)
    return everything.take(index[np.argsort(z[index], kind="stable")]), visible


def _meets(centre: np.ndarray, half: np.ndarray, pixels: slice) -> np.ndarray:
    """Return True where `centre +- half` reaches a pixel centre between the first and the last of `pixels`."""
    return (centre + half >= pixels.start + 0.5) & (centre - half <= pixels.stop - 0.5)


def _weights(
    splats: _Splats, index: np.ndarray, rows: slice, columns: slice, limit: np.ndarray, config: RasterConfig
) -> Iterator[tuple[_Splats, np.ndarray]]:
    """Yield the splats at `index`, a slab at a time, with their light in every pixel of a tile (splats, h w)."""
    y, x = (axis.ravel() + 0.5 for axis in np.mgrid[rows, columns])
    light = np.ones((1, len(x)))  # transmittance of every pixel
    for start in range(0, len(index), SLAB):
        slab = splats.take(index[start : start + SLAB])
        mean_x, mean_y, a, slope, c, opacity, z = (
            column[:, None] for column in (slab.x, slab.y, slab.a, slab.slope, slab.c, slab.opacity, slab.z)
        )
        dy = y - mean_y
        alpha = opacity * np.exp(-0.5 * (a * (x - mean_x - slope * dy) ** 2 + c * dy**2))
        alpha = np.where((alpha < config.alpha_min) | (z >= limit.ravel()), 0, np.minimum(alpha, config.alpha_max))
        passing = np.cumprod(np.concatenate([light, 1 - alpha]), 0)  # before and after every splat
        yield slab, np.where(passing[1:] > config.transmittance_min, alpha * passing[:-1], 0)
        light = passing[-1:]
        if (light <= config.transmittance_min).all():
            break
