"""The opacity of Gaussians on a regular grid, and values of theirs that vary with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...geometry import quaternion
from ...geometry.splats import Splats

REACH = 3.0
"""Standard deviations up to which a Gaussian is summed: beyond lies 1 % of its peak."""
NARROWEST = 0.7
"""Smallest standard deviation in grid steps: a sheet of opaque Gaussians half a step from the nearest grid points still
reaches the level 0.5 there."""
MAX_OPACITY = 0.99
"""Largest opacity of one Gaussian: an opacity of 1 would be an infinite optical depth."""
TRIMMED, MARGIN = 1.0, 0.25
"""Percent of the centres left out at both ends of each axis, and the fraction of what remains that is added there: stray Gaussians
far from a thing would else cost it its resolution."""
BLOCK = 1 << 22
"""Numbers that are summed together: about 200 MB of work memory."""
ALIKE = 1.3
"""Times that the widest Gaussian of a block is wider than its narrowest: all get as many points."""


@dataclass(frozen=True)
class Grid:
    """Points `origin + step * (i, j, k)`."""

    origin: np.ndarray
    """(3,) world."""
    step: float
    """World units."""
    shape: tuple[int, int, int]
    """Points along each axis."""

    @classmethod
    def around(cls, splats: Splats, resolution: int) -> Grid:
        """Return a grid around most of `splats` with `resolution` steps along its longest side, and an empty layer around."""
        means = np.asarray(splats.means, np.float64)
        reach = REACH * _deviations(splats)
        low, high = np.percentile(means, [TRIMMED, 100 - TRIMMED], axis=0)
        room = MARGIN * (high - low).max() + np.median(reach, axis=0)
        low = np.maximum(low - room, (means - reach).min(0))
        high = np.minimum(high + room, (means + reach).max(0))
        step = max(float(np.max(high - low)) / resolution, float(np.finfo(np.float32).tiny))
        sides = np.ceil((high - low) / step).astype(int) + 3
        return cls(low - step, step, (int(sides[0]), int(sides[1]), int(sides[2])))

    def sample(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the values (P,C) at `points (P,3)` by trilinear interpolation of `values (X,Y,Z,C)`; the border's beyond it."""
        place = np.clip((points - self.origin) / self.step, 0, np.array(self.shape) - 1.001)
        corner = place.astype(int)
        found = np.zeros((len(points), values.shape[-1]))
        for offset in np.ndindex(2, 2, 2):
            near = 1 - np.abs(place - corner - offset)
            i, j, k = (corner + offset).T
            found += near.prod(1)[:, None] * values[i, j, k]
        return found


def opacity_field(splats: Splats, grid: Grid, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (opacity (X,Y,Z) float32 in [0, 1), (X,Y,Z,C+1) float32 sums of `values (N,C)` by optical depth, and of the depth).

    Opacity at a point is `1 - prod(1 - a g)` over all Gaussians of opacity a and value g there. A Gaussian that is narrower
    than the grid can show is widened to `NARROWEST` steps and pales by what its two widest axes grow: it covers the same area.
    The outermost points are empty, so that every surface in the field is closed.
    """
    scales = np.asarray(splats.scales, np.float64)
    wide = np.maximum(scales, NARROWEST * grid.step)
    kept = np.sort(scales / wide, axis=1)[:, 1:].prod(1)
    alpha = np.minimum(splats.opacities, MAX_OPACITY) * kept
    turn = quaternion.to_matrix(np.asarray(splats.quats, np.float64))
    deviation = np.sqrt((turn**2 * (wide**2)[:, None]).sum(2))
    precision = (turn / (wide**2)[:, None]) @ turn.transpose(0, 2, 1) * grid.step**2
    place = (np.asarray(splats.means, np.float64) - grid.origin) / grid.step
    low = np.maximum(np.ceil(place - REACH * deviation / grid.step), 1).astype(np.int64)
    high = np.minimum(np.floor(place + REACH * deviation / grid.step), np.array(grid.shape) - 2).astype(np.int64)
    count = high - low + 1
    size = int(np.prod(grid.shape))
    depth, total = np.zeros(size), np.zeros((values.shape[1], size))
    for rows in _blocks(count):
        at, share = _contributions(place[rows], precision[rows], low[rows], count[rows].max(0), grid.shape)
        share = -np.log1p(-alpha[rows, None] * share)
        inside = at >= 0
        flat, share = at[inside], share[inside]
        depth += np.bincount(flat, share, size)
        owner = np.repeat(rows, inside.sum(1))
        for channel in range(values.shape[1]):
            total[channel] += np.bincount(flat, values[owner, channel] * share, size)
    sums = np.concatenate([total, depth[None]]).T.astype(np.float32)
    return (1 - np.exp(-depth)).astype(np.float32).reshape(grid.shape), sums.reshape(*grid.shape, -1)


def _blocks(count: np.ndarray) -> Iterator[np.ndarray]:
    """Yield rows of `count (N,3)`, the grid points of each Gaussian along each axis, in blocks of similar counts."""
    side = count.max(1)
    order = np.argsort(side, kind="stable")
    order = order[(count[order] > 0).all(1)]
    while len(order):
        alike = np.searchsorted(side[order], side[order[0]] * ALIKE, side="right")
        rows = order[: max(1, min(int(alike), BLOCK // int(side[order[alike - 1]]) ** 3))]
        yield rows
        order = order[len(rows) :]


def _contributions(
    place: np.ndarray, precision: np.ndarray, low: np.ndarray, count: np.ndarray, shape: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (flat index (n,m) of the grid points around each Gaussian, -1 beyond; value of the Gaussian there).

    `place (n,3)`, `precision (n,3,3)`, `low (n,3)` in grid steps; `count (3,)` points along each axis.
    """
    index = [low[:, axis, None] + np.arange(count[axis]) for axis in range(3)]
    x, y, z = (index[axis] - place[:, axis, None] for axis in range(3))
    x, y, z = x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]
    p = precision[:, :, :, None, None, None]
    power = p[:, 0, 0] * x * x + p[:, 1, 1] * y * y + p[:, 2, 2] * z * z
    power = power + 2 * (p[:, 0, 1] * x * y + p[:, 0, 2] * x * z + p[:, 1, 2] * y * z)
    inside = [index[axis] < shape[axis] - 1 for axis in range(3)]
    i, j, k = index
    flat = (i[:, :, None, None] * shape[1] + j[:, None, :, None]) * shape[2] + k[:, None, None, :]
    there = inside[0][:, :, None, None] & inside[1][:, None, :, None] & inside[2][:, None, None, :]
    there &= power < REACH**2
    return np.where(there, flat, -1).reshape(len(place), -1), np.exp(-0.5 * power).reshape(len(place), -1)


def _deviations(splats: Splats) -> np.ndarray:
    """Return (N,3) standard deviation of each Gaussian along the world's axes."""
    turn = quaternion.to_matrix(np.asarray(splats.quats, np.float64))
    return np.sqrt((turn**2 * (np.asarray(splats.scales, np.float64) ** 2)[:, None]).sum(2))
