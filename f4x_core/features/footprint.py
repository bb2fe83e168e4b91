"""Which Gaussian lights which cell of a picture: a sparse matrix per view.

Where geometry and opacity stand still, compositing is linear in the channels. The matrix is measured once per view, and
every further look at any channels is one sparse product, about thirty times cheaper than drawing the view again.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ..geometry.camera import Camera
from ..raster import RasterConfig
from ..raster.light import light_into

PERIOD = 8
"""Cells of one colour are this many apart, see `cell_light`; 8 x 8 colours are drawn as channels."""
LEAST_LIGHT = 0.01
"""Pixels of light below which a Gaussian's part in a cell is forgotten."""


def cell_light(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    camera: Camera,
    grid: tuple[int, int],
    *,
    config: RasterConfig | None = None,
    backend: str = "auto",
) -> sparse.csr_matrix:
    """(h*w, N) float32: light, in pixels of `camera`, that each cell of `grid` (h, w) gets from each Gaussian.

    A row's sum is the covered area of its cell. Gaussians as in `raster.rasterize`, float32.

    Cells are coloured with period `PERIOD` across and down, one layer per colour, so one look gives the light per colour
    (`raster.light`); the cell meant is the one of that colour next to the Gaussian's centre. A Gaussian wider than
    `PERIOD` cells is heard in the right colours but partly in the wrong cells.
    """
    rows, columns = grid
    cell_row = ((np.arange(camera.height) + 0.5) * rows / camera.height).astype(int)
    cell_column = ((np.arange(camera.width) + 0.5) * columns / camera.width).astype(int)
    colour = (cell_row % PERIOD)[:, None] * PERIOD + (cell_column % PERIOD)[None]  # (H,W)
    layers = np.eye(PERIOD**2, dtype=np.float32)[colour]  # (H,W,colours)
    shapes, view = (means, quats, scales, opacities), (camera.world_to_camera, camera.intrinsics)
    light = light_into(*shapes, *view, layers, config=config, backend=backend)  # (N, colours)
    gaussian, seen = np.nonzero(light > LEAST_LIGHT)
    pixels, _ = camera.project(means[gaussian].astype(np.float64))
    row = _nearest(pixels[:, 1] * rows / camera.height - 0.5, seen // PERIOD, rows)
    column = _nearest(pixels[:, 0] * columns / camera.width - 0.5, seen % PERIOD, columns)
    shape = (rows * columns, len(means))
    return sparse.csr_matrix((light[gaussian, seen], (row * columns + column, gaussian)), shape, dtype=np.float32)


def _nearest(position: np.ndarray, remainder: np.ndarray, count: int) -> np.ndarray:
    """The index below `count` that leaves `remainder` when divided by `PERIOD` and is next to `position`."""
    index = remainder + PERIOD * np.round((np.clip(position, 0, count - 1) - remainder) / PERIOD).astype(int)
    index = np.where(index < 0, index + PERIOD, index)
    return np.where(index >= count, index - PERIOD, index)
