"""A selection grown or shrunk by what lies near, and the thing under a ray. Needs numpy alone."""

from __future__ import annotations

from itertools import product

import numpy as np

from ..geometry import quaternion
from ..scene.model import PosedSplats

FINE = 2
"""Cells that make up a step: what is nearer than a step is found to half of one."""
MAX_CELLS = 1 << 20
"""Cells along an axis at most: three of them number a cell within 64 bits, however far a floater is."""
SOLID = 0.5
"""Light that a ray has lost where it meets a surface."""


def grow_selection(points: np.ndarray, chosen: np.ndarray, reach: float) -> np.ndarray:
    """Return `chosen (N,)` and the `points (N,3)` within `reach` of one, (N,) bool, measured in cells of `reach / FINE`."""
    if not chosen.any():
        return chosen.copy()
    width = max(reach / FINE, float(np.ptp(points, axis=0).max()) / MAX_CELLS, 1e-9)
    cells = np.floor(points / width).astype(np.int64)
    cells -= cells.min(0) - FINE  # room for neighbours before each row, and so behind the row before it
    size = cells.max(0) + 1
    keys = np.ravel_multi_index(tuple(cells.T), tuple(size))
    there, index = np.unique(keys, return_inverse=True)
    full = np.unique(keys[chosen])
    near = np.zeros(len(there), bool)
    strides = np.array([size[1] * size[2], size[2], 1])
    for step in product(range(-FINE, FINE + 1), repeat=3):
        if np.dot(step, step) <= FINE**2:
            beside = full + np.dot(step, strides)
            place = np.minimum(np.searchsorted(there, beside), len(there) - 1)
            near[place[there[place] == beside]] = True
    return chosen | near[index]


def shrink_selection(points: np.ndarray, chosen: np.ndarray, reach: float) -> np.ndarray:
    """Return `chosen (N,)` bool without those within `reach` of a point that is not chosen."""
    return ~grow_selection(points, ~chosen, reach)


def meeting(posed: PosedSplats, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
    """Return the place (3,) where the ray from `origin (3,)` along `direction (3,)` meets a surface of `posed`; None without one.

    A Gaussian takes from the ray what its density is where the ray comes nearest to its centre, in its own metric.
    """
    origin, direction = (
        np.array(origin, np.float64),
        np.array(direction, np.float64),
    )  # in float32 thin Gaussians are missed
    own = quaternion.conjugate(posed.quats)
    scales = np.maximum(posed.scales, 1e-9)
    start = quaternion.rotate(own, origin - posed.means) / scales
    along = quaternion.rotate(own, np.broadcast_to(direction, posed.means.shape)) / scales
    length = (along**2).sum(1)
    distance = -(start * along).sum(1) / length
    off = np.maximum((start**2).sum(1) - distance**2 * length, 0)
    alpha = posed.opacities * np.exp(-0.5 * off)
    met = np.flatnonzero((distance > 0) & (alpha > 1 / 255))
    met = met[np.argsort(distance[met], kind="stable")]
    left = np.cumprod(1 - alpha[met])
    solid = np.flatnonzero(left <= 1 - SOLID)
    if not len(solid):
        return None
    there: np.ndarray = origin + distance[met[solid[0]]] * direction
    return there
