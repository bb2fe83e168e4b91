"""The surface where a field on a grid passes a level, by marching tetrahedra (Doi and Koide 1991).

Each cube of grid points is cut into six tetrahedra around its diagonal, alike in every cube, so that neighbours share faces: every
edge of the surface has exactly two triangles, which marching cubes must earn with larger tables. numpy alone.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

AWAY = 0.02
"""Least distance of a vertex from the grid points, as a fraction of its grid edge: nearer ones make triangles without area."""


def _cases() -> list[tuple[np.ndarray, dict[int, list[list[tuple[int, int]]]]]]:
    """Return for each tetrahedron its corners (4,3) in the cube, and the triangles of each set of inner corners (bits).

    The corners of a triangle are pairs (corner, corner) of the tetrahedron, the one nearer the cube's origin first. Seen from
    outside the triangles turn to the left.
    """
    tables = []
    for order in permutations(np.eye(3, dtype=int)):
        corners = np.concatenate([np.zeros((1, 3), int), np.cumsum(order, axis=0)])
        cases = {}
        for bits in range(1, 15):
            inner = [corner for corner in range(4) if bits >> corner & 1]
            outer = [corner for corner in range(4) if not bits >> corner & 1]
            ring = [(i, o) for n, i in enumerate(inner) for o in (outer if n == 0 else outer[::-1])]
            middle = np.array([(corners[i] + corners[o]) / 2 for i, o in ring])
            normal = np.cross(middle[1] - middle[0], middle[2] - middle[0])
            if normal @ (corners[outer].mean(0) - corners[inner].mean(0)) < 0:
                ring = ring[::-1]
            edges = [(min(edge), max(edge)) for edge in ring]
            cases[bits] = [[edges[0], edges[n], edges[n + 1]] for n in range(1, len(edges) - 1)]
        tables.append((corners, cases))
    return tables


CASES = _cases()


def contour(field: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (vertices (V,3) float64 in grid steps, triangles (F,3) int64) of the surface around `field (X,Y,Z) > level`.

    Triangles turn to the left seen from where the field is below. The surface is closed where the field's border is below.
    """
    inside = field > level
    stride = np.array([field.shape[1] * field.shape[2], field.shape[2], 1])
    whole = np.zeros(tuple(side - 1 for side in field.shape), np.int8)
    for offset in np.ndindex(2, 2, 2):
        whole += inside[tuple(slice(o, side - 1 + o) for o, side in zip(offset, field.shape, strict=True))]
    cubes = np.argwhere((whole > 0) & (whole < 8)) @ stride
    flat = inside.ravel()
    found = []
    for corners, cases in CASES:
        points = cubes[:, None] + corners @ stride  # (cubes, 4)
        bits = (flat[points] << np.arange(4)).sum(1)
        for case, triangles in cases.items():
            here = points[bits == case]
            for triangle in triangles:
                ends = np.array(triangle)
                # An edge of the grid is known by its first point and which of seven ways it goes.
                ways = (corners[ends[:, 1]] - corners[ends[:, 0]]) @ [4, 2, 1]
                found.append(here[:, ends[:, 0]] * 8 + ways)
    edges, faces = np.unique(np.concatenate([np.zeros((0, 3), np.int64), *found]), return_inverse=True)
    start, way = edges // 8, edges % 8
    offset = np.stack([way >> 2 & 1, way >> 1 & 1, way & 1], axis=1)
    values = field.ravel()
    a, b = values[start].astype(np.float64), values[start + offset @ stride].astype(np.float64)
    part = np.clip((level - a) / (b - a), AWAY, 1 - AWAY)
    corner = np.stack(np.unravel_index(start, field.shape), axis=1)
    return corner + part[:, None] * offset, faces.reshape(-1, 3)
