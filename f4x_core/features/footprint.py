"""Blend weights of Gaussians in the pixels of a feature map: a sparse matrix per view.

Where geometry and opacity stand still, compositing is linear in the channels. The matrix is measured once per view, and
every further look at any channels is one sparse product, about thirty times cheaper than drawing the view again.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..raster import RasterConfig
from ..raster.blend_weights import blend_weight_sums

PERIOD = 8
"""Cells of one colour are this many apart, see `cell_weights`; 8 x 8 colours are drawn as channels."""
MIN_SUM = 0.01
"""Pixels below which a Gaussian's part in a cell is forgotten."""


def cell_weights(
    splats: Splats, camera: Camera, grid: tuple[int, int], *, config: RasterConfig | None = None, backend: str = "auto"
) -> sparse.csr_matrix:
    """Return (h*w, N) float32: blend weights of each Gaussian, summed over the pixels of `camera` in each cell of `grid` (h, w).

    A row's sum is the covered area of its cell.

    Cells are coloured with period `PERIOD` across and down, one layer per colour, so one pass gives the sums per colour
    (`raster.blend_weights`); the cell meant is the one of that colour next to the Gaussian's centre. A Gaussian wider than
    `PERIOD` cells is heard in the right colours but partly in the wrong cells.
    """
    rows, columns = grid
    cell_row = ((np.arange(camera.height) + 0.5) * rows / camera.height).astype(int)
    cell_column = ((np.arange(camera.width) + 0.5) * columns / camera.width).astype(int)
    colour = (cell_row % PERIOD)[:, None] * PERIOD + (cell_column % PERIOD)[None]  # (H,W)
    layers = np.eye(PERIOD**2, dtype=np.float32)[colour]  # (H,W,colours)
    sums = blend_weight_sums(splats, camera, layers, config=config, backend=backend)  # (N, colours)
    gaussian, seen = np.nonzero(sums > MIN_SUM)
    pixels, _ = camera.project(splats.means[gaussian].astype(np.float64))
    row = _nearest(pixels[:, 1] * rows / camera.height - 0.5, seen // PERIOD, rows)
    column = _nearest(pixels[:, 0] * columns / camera.width - 0.5, seen % PERIOD, columns)
    shape = (rows * columns, len(splats))
    return sparse.csr_matrix((sums[gaussian, seen], (row * columns + column, gaussian)), shape, dtype=np.float32)


def _nearest(position: np.ndarray, remainder: np.ndarray, count: int) -> np.ndarray:
    """Return the index below `count` that leaves `remainder` when divided by `PERIOD` and is next to `position`."""
    index = remainder + PERIOD * np.round((np.clip(position, 0, count - 1) - remainder) / PERIOD).astype(int)
    index = np.where(index < 0, index + PERIOD, index)
    return np.where(index >= count, index - PERIOD, index)
