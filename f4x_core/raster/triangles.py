"""Depth of opaque triangles per pixel, in numpy alone: what stands before Gaussians and what is seen behind them.

Homogeneous edge functions (Olano and Greer 1997): with the corners' (u z, v z, z) as the columns of M, `e = M^-1 (u, v, 1)`
holds the barycentric coordinates divided by z. A pixel lies inside where all of e >= 0 and has the depth 1 / sum(e);
triangles that reach behind the camera need no clipping. Every e is linear in u, so a pixel row is one interval.
"""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera

PIXELS = 1 << 21
"""Covered pixels worked on together: about 100 MB of work memory."""
FLAT = 1e-12
"""A triangle whose determinant is smaller, relative to its corners, is seen edge-on or has no area."""
SLACK = 1e-6
"""Pixels added to both ends of an interval, so that rounding opens no crack between neighbours."""


def draw_triangles(
    triangles: np.ndarray, camera: Camera, *, near: float = 0.01, far: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Return (depth (H,W) float64 camera z, index (H,W) int64) of the nearest triangle through every pixel centre.

    Where there is none, the depth is infinite and the index -1.

    Args:
        triangles: (T, 3, 3) corners, world frame; both sides count.
        camera: numpy; where they are seen from, and the size of the image.
        near: least camera z that is seen, above 0.
        far: camera z from which on nothing is seen.
    """
    viewmat, K, width, height = camera.world_to_camera, camera.intrinsics, camera.width, camera.height
    depth, index = np.full(height * width, np.inf), np.full(height * width, -1)
    local = np.asarray(triangles, np.float64).reshape(-1, 3, 3) @ viewmat[:3, :3].T + viewmat[:3, 3]
    corners = local @ K.T  # (T, 3 corners, 3): u z, v z, z
    top, rows = _rows_met(corners, height, near)
    sizes = np.prod(np.linalg.norm(corners, axis=2), axis=1)
    edges = edge_functions(corners)
    volume = (corners[:, 0] * edges[:, 0]).sum(1)
    seen = np.flatnonzero((rows > 0) & (np.abs(volume) > FLAT * sizes))
    edges = edges[seen] / volume[seen, None, None]  # (V, 3, 3): e = edges (u, v, 1)

    item, offset = _expand(rows[seen])  # one item per (triangle, pixel row)
    triangle, row = seen[item], top[seen[item]] + offset
    slope, rest = edges[item, :, 0], edges[item, :, 1] * (row + 0.5)[:, None] + edges[item, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = -rest / slope  # NaN only where slope and rest are 0: that edge lets everything in
    first = np.fmax.reduce(np.where(slope > 0, zero, np.where((slope == 0) & (rest < 0), np.inf, -np.inf)), axis=1)
    last = np.fmin.reduce(np.where(slope < 0, zero, np.inf), axis=1)
    first = np.clip(np.ceil(first - 0.5 - SLACK), 0, width).astype(np.int64)
    last = np.clip(np.floor(last - 0.5 + SLACK), -1, width - 1).astype(np.int64)
    counts = np.maximum(last - first + 1, 0)
    slope, rest = slope.sum(1), rest.sum(1)  # of 1 / z

    batches = np.cumsum(counts) // PIXELS
    for batch in np.unique(batches):
        chosen = np.flatnonzero(batches == batch)
        number, offset = _expand(counts[chosen])
        span = chosen[number]
        column = first[span] + offset
        with np.errstate(divide="ignore"):
            z = 1 / (slope[span] * (column + 0.5) + rest[span])
        kept = (z >= near) & (z < far)
        pixel, z, span = (row[span] * width + column)[kept], z[kept], span[kept]
        np.minimum.at(depth, pixel, z)
        nearest = depth[pixel] == z
        index[pixel[nearest]] = triangle[span[nearest]]
    return depth.reshape(height, width), index.reshape(height, width)


def edge_functions(corners: np.ndarray) -> np.ndarray:
    """Return (T,3,3) `edges`, so that `edges (u, v, 1)` are in proportion to the barycentric coordinates divided by z.

    Args:
        corners: (T,3,3) u z, v z, z of each corner.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners.transpose(1, 2, 0)
    # the cofactors of the matrix whose columns are the corners
    rows = (
        (by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx),
        (cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax),
        (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx),
    )
    return np.array(rows).transpose(2, 0, 1)


def _rows_met(corners: np.ndarray, height: int, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (first row, number of rows), each (T,), that the part of a triangle beyond `near` may cover."""
    ahead = np.roll(corners, -1, axis=1)
    z, next_z = corners[..., 2], ahead[..., 2]
    crosses = (z > near) != (next_z > near)
    fraction = np.where(crosses, (near - z) / np.where(crosses, next_z - z, 1), 0)
    points = np.concatenate([corners, corners + fraction[..., None] * (ahead - corners)], 1)  # (T, 6, 3)
    counts = np.concatenate([z > near, crosses], 1)
    v = points[..., 1] / np.where(counts, points[..., 2], 1)
    first = np.clip(np.ceil(np.where(counts, v, np.inf).min(1) - 0.5 - SLACK), 0, height)
    last = np.clip(np.floor(np.where(counts, v, -np.inf).max(1) - 0.5 + SLACK), -1, height - 1)
    return first.astype(np.int64), np.maximum(last - first + 1, 0).astype(np.int64)


def _expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (number, offset): item `number` occurs `counts[number]` times, with `offset` running from 0."""
    number = np.repeat(np.arange(len(counts)), counts)
    return number, np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
