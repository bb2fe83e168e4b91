"""Cleaning a closed triangle mesh: small parts and hollows out, bumps smoothed, edges collapsed to a number of triangles.

Triangles turn to the left seen from outside. numpy alone.
"""

from __future__ import annotations

import numpy as np

SMOOTH, SWELL = 0.5, -0.53
"""Steps towards the mean of the neighbours and back, so that smoothing does not shrink (Taubin 1995)."""
FIRM = 1e-3
"""Weight of staying near the old places, by that of staying on the old planes: in a plane the latter leave places open."""
TURNED = 0.2
"""Least cosine between the normals of a triangle before and after a collapse."""
CHEAP = 3
"""Times as many edges as have yet to collapse that count as cheap."""
ROUNDS = 400
"""Rounds of collapses at most; each takes about a tenth of the vertices."""


def parts_of(vertices: int, faces: np.ndarray) -> np.ndarray:
    """Return for each of so many vertices the number of the connected part it is in: (V,) int64 from 0."""
    label = np.arange(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    while True:
        least = np.minimum(label[ends[:, 0]], label[ends[:, 1]])
        before = label.copy()
        np.minimum.at(label, ends.ravel(), np.repeat(least, 2))
        label = np.minimum(label, label[label])
        if np.array_equal(label, before):
            return np.unique(label, return_inverse=True)[1]


def largest_parts(
    vertices: np.ndarray, faces: np.ndarray, least: float, hollows: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh without parts whose area is below `least` of the largest part's, and without the walls of hollows.

    The wall of a hollow is a closed part whose volume is negative; `hollows` keeps those.
    """
    part = parts_of(len(vertices), faces)[faces[:, 0]] if len(faces) else np.zeros(0, int)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.bincount(part, np.linalg.norm(np.cross(b - a, c - a), axis=1))
    volume = np.bincount(part, (a * np.cross(b, c)).sum(1))
    if not hollows:
        area = np.where(volume > 0, area, 0.0)
    return compacted(vertices, faces[(area > 0)[part] & (area >= least * area.max(initial=0))[part]])


def smoothed(vertices: np.ndarray, faces: np.ndarray, rounds: int) -> np.ndarray:
    """Return the vertices after so many rounds of smoothing, each a step to the neighbours' mean and a step back."""
    ends = edges_of(faces)
    for step in (SMOOTH, SWELL) * rounds:
        vertices = vertices + step * (neighbour_means(vertices, ends) - vertices)
    return vertices


def neighbour_means(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return for each vertex the mean of `values (V,C)` over those that the edges `ends (E,2)` join it with."""
    degree = np.maximum(np.bincount(ends.ravel(), minlength=len(values)), 1)
    total = np.empty(values.shape)
    for column, value in enumerate(values.T):
        total[:, column] = np.bincount(ends[:, 0], value[ends[:, 1]], len(values))
        total[:, column] += np.bincount(ends[:, 1], value[ends[:, 0]], len(values))
    return total / degree[:, None]


def decimated(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh with at most `count` triangles where collapses allow it: quadric errors (Garland and Heckbert 1997).

    Edges collapse in rounds, in each those that are the cheapest of their surroundings. A collapse that would join sheets, open
    the surface or turn a triangle over is left out, so a closed surface stays closed.
    """
    quadrics = _quadrics(vertices, faces)
    for _ in range(ROUNDS):
        if len(faces) <= count:
            break
        ends = edges_of(faces)
        places, cost = _best_places(vertices, quadrics, ends)
        left = (len(faces) - count + 1) // 2
        chosen = _independent(len(vertices), ends, cost, min(CHEAP * left, len(ends) // 2))
        chosen = chosen[_closed_after(len(vertices), faces, ends, chosen)]
        chosen = chosen[np.argsort(cost[chosen], kind="stable")]
        chosen = chosen[_not_turned(vertices, faces, ends[chosen], places[chosen])]
        chosen = chosen[:left]
        if not len(chosen):
            break
        kept, gone = ends[chosen].T
        vertices[kept], quadrics[kept] = places[chosen], quadrics[kept] + quadrics[gone]
        goes = np.arange(len(vertices))
        goes[gone] = kept
        faces = goes[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        used = np.unique(faces)
        vertices, quadrics, faces = vertices[used], quadrics[used], np.searchsorted(used, faces)
    return vertices, faces


def compacted(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh without vertices that no triangle uses."""
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def edges_of(faces: np.ndarray) -> np.ndarray:
    """Return (E,2) int64: every edge once, its smaller vertex first."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    stride = int(faces.max(initial=0)) + 1
    keys = np.unique(ends[:, 0] * stride + ends[:, 1])
    return np.stack([keys // stride, keys % stride], axis=1)


def normals_of(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return (F,3) normals whose length is twice the area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def _quadrics(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return (V,4,4): `x Q x` is the squared distance of x = (place, 1) from the planes around, weighted by area."""
    normal = normals_of(vertices, faces)
    area = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(area, np.finfo(float).tiny)[:, None]
    plane = np.concatenate([normal, -(normal * vertices[faces[:, 0]]).sum(1, keepdims=True)], axis=1)
    own = area[:, None, None] * plane[:, :, None] * plane[:, None]
    total = np.zeros((len(vertices), 4, 4))
    for corner in range(3):
        np.add.at(total, faces[:, corner], own)
    stay = np.zeros_like(total)
    stay[:, :3, :3] = np.eye(3)
    stay[:, :3, 3] = stay[:, 3, :3] = -vertices
    stay[:, 3, 3] = (vertices**2).sum(1)
    around = np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices))
    return total + FIRM * around[:, None, None] * stay


def _best_places(vertices: np.ndarray, quadrics: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each edge the place (E,3) with the least error that its two ends may become, and the error (E,)."""
    total = quadrics[ends[:, 0]] + quadrics[ends[:, 1]]
    middle = (vertices[ends[:, 0]] + vertices[ends[:, 1]]) / 2
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    # about the middle: the same numbers for a mesh far from the origin
    slope = (total[:, :3, :3] @ middle[..., None])[..., 0] + total[:, :3, 3]
    firm = 1e-9 * np.trace(total[:, :3, :3], axis1=1, axis2=2)[:, None, None] * np.eye(3)
    with np.errstate(all="ignore"):
        step = -np.linalg.solve(total[:, :3, :3] + firm + np.finfo(float).tiny * np.eye(3), slope[..., None])[..., 0]
    far = ~(np.linalg.norm(step, axis=1) <= length)
    places = middle + np.where(far[:, None], 0.0, step)
    whole = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    return places, ((total @ whole[..., None])[..., 0] * whole).sum(1)


def _independent(vertices: int, ends: np.ndarray, cost: np.ndarray, cheap: int) -> np.ndarray:
    """Return edges of which none ends at or beside an end of another: the cheapest of their surroundings.

    The `cheap` cheapest ones come in any order: neighbours cost alike, so few would be the cheapest of theirs.
    """
    order = np.argsort(cost, kind="stable")
    order[:cheap] = np.random.default_rng(0).permutation(order[:cheap])
    rank = np.empty(len(ends), np.int64)
    rank[order] = np.arange(len(ends))
    own = np.full(vertices, len(ends))
    for end in range(2):
        np.minimum.at(own, ends[:, end], rank)
    near = own.copy()
    for end in range(2):
        np.minimum.at(near, ends[:, end], own[ends[:, 1 - end]])
    return np.flatnonzero(rank == np.minimum(near[ends[:, 0]], near[ends[:, 1]]))


def _closed_after(vertices: int, faces: np.ndarray, ends: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return (n,) bool: the ends of a chosen edge have exactly two neighbours in common, those of its two triangles."""
    both = np.concatenate([ends, ends[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    start = np.searchsorted(both[:, 0], np.arange(vertices + 1))
    owner, beside = [], []
    for end in range(2):
        at = ends[chosen, end]
        size = start[at + 1] - start[at]
        owner.append(np.repeat(np.arange(len(chosen)), size))
        place = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size) + np.repeat(start[at], size)
        beside.append(both[place, 1])
    keys, times = np.unique(np.concatenate(owner) * vertices + np.concatenate(beside), return_counts=True)
    common = np.bincount(keys[times == 2] // vertices, minlength=len(chosen))
    return common == 2


def _not_turned(vertices: np.ndarray, faces: np.ndarray, ends: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (n,) bool: no triangle beside the independent edges `ends (n,2)` turns over when they become `places (n,3)`."""
    edge = np.full(len(vertices), -1)
    edge[ends[:, 0]] = edge[ends[:, 1]] = np.arange(len(ends))
    moved = vertices.copy()
    moved[ends[:, 0]] = moved[ends[:, 1]] = places
    touched = edge[faces]
    changed = (touched >= 0).sum(1) == 1  # both ends: the triangle goes
    before, after = normals_of(vertices, faces[changed]), normals_of(moved, faces[changed])
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    bad = (before * after).sum(1) <= TURNED * sizes
    good = np.ones(len(ends), bool)
    good[touched[changed].max(1)[bad]] = False
    return good
