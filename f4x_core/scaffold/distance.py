"""The curve distance D: how far two trajectories ever get apart. numpy."""

import numpy as np

CHUNK = 4096
"""Pairs of curves per block; with a hundred frames a block and its temporaries stay in a few megabytes of cache."""


def curve_distance(xyz: np.ndarray, certain: np.ndarray | None = None, kth: int = 1, chunk: int = CHUNK) -> np.ndarray:
    """Return the symmetric `(M, M)` float32 distances between curves `xyz (F, M, 3)`, world units.

    The `k`-th largest distance over the frames where both are `certain (F, M)` (all frames without it), with `k =
    max(1, ceil(kth * common / F))` for `common` such frames; kth = 1 is the maximum. 0 on the diagonal and between
    duplicates, infinite between curves that are never certain together.
    """
    nodes = xyz.shape[1]
    rows, columns = np.triu_indices(nodes, 1)
    curves = np.ascontiguousarray(xyz.transpose(1, 0, 2), np.float32)  # (M, F, 3)
    seen = None if certain is None else np.ascontiguousarray(certain.T)
    result = np.zeros((nodes, nodes), np.float32)
    for start in range(0, len(rows), chunk):
        a, b = rows[start : start + chunk], columns[start : start + chunk]
        common = None if seen is None else seen[a] & seen[b]
        result[a, b] = result[b, a] = _reduced(curves[a], curves[b], common, kth)
    return result


def distance_to(
    xyz: np.ndarray,
    other: np.ndarray,
    certain: np.ndarray | None = None,
    other_certain: np.ndarray | None = None,
    kth: int = 1,
) -> np.ndarray:
    """Return `(A, B)` float32 distances from curves `xyz (F, A, 3)` to `other (F, B, 3)`, as `curve_distance`."""
    if certain is None or other_certain is None:
        certain = other_certain = None
    if kth == 1:
        return _largest(xyz, other, certain, other_certain)
    curves, others = (np.ascontiguousarray(c.transpose(1, 0, 2), np.float32) for c in (xyz, other))
    result = np.empty((len(curves), len(others)), np.float32)
    for i, curve in enumerate(curves):
        common = None if certain is None or other_certain is None else certain[:, i] & other_certain.T  # (B, F)
        result[i] = _reduced(curve[None], others, common, kth)
    return result


def _largest(
    xyz: np.ndarray, other: np.ndarray, certain: np.ndarray | None, other_certain: np.ndarray | None
) -> np.ndarray:
    """Return `distance_to` for the largest distance: in a third of the time, with an array for each coordinate and frames first."""
    result = np.empty((xyz.shape[1], other.shape[1]), np.float32)
    curves = np.ascontiguousarray(xyz.transpose(2, 0, 1), np.float32)  # (3, F, A)
    for start in range(0, other.shape[1], CHUNK):
        block = slice(start, start + CHUNK)
        others = np.ascontiguousarray(other[:, block].transpose(2, 0, 1), np.float32)  # (3, F, b)
        for i in range(xyz.shape[1]):
            frames = slice(None) if certain is None else np.flatnonzero(certain[:, i])
            pairs = zip(curves[:, :, i], others, strict=True)
            squared = sum((many[frames] - one[frames, None]) ** 2 for one, many in pairs)
            if other_certain is not None:
                squared *= other_certain[frames, block]
            result[i, block] = np.sqrt(squared.max(axis=0, initial=0))
            if other_certain is not None:
                result[i, block][~other_certain[frames, block].any(axis=0)] = np.inf
    return result


def _reduced(a: np.ndarray, b: np.ndarray, common: np.ndarray | None, kth: int) -> np.ndarray:
    """Return the k-th largest distance `(P,)` between `a` and `b (P, F, 3)` over the frames in `common (P, F)`."""
    difference = a - b
    squared = np.einsum("pfc,pfc->pf", difference, difference)
    frames = squared.shape[1]
    if common is None:
        k = np.full(len(squared), kth)
    else:
        squared = np.where(common, squared, -1.0)  # below every distance, so never among the k largest common ones
        k = np.ceil(kth * common.sum(axis=1) / frames).astype(np.int64)
    if kth == 1:
        chosen = squared.max(axis=1)
    else:
        k = np.clip(k, 1, frames)
        chosen = np.take_along_axis(np.sort(squared, axis=1), (frames - k)[:, None], axis=1)[:, 0]
    return np.where(chosen < 0, np.inf, np.sqrt(np.maximum(chosen, 0)))
