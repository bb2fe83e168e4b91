"""First node rotations from the motion of the points around each node. numpy."""

import numpy as np

from ..geometry import quaternion

COLLINEAR = 1e-6
"""Neighbourhoods whose second singular value is below this fraction of the first leave the turn about a line open."""
_UNCERTAIN_WEIGHT = 1e-2
"""Filled-in samples count only where nothing was observed: a held end would otherwise pull towards no rotation."""


def initial_rotations(
    neighbours: np.ndarray, edge_mask: np.ndarray, points: np.ndarray, certain: np.ndarray | None = None
) -> np.ndarray:
    """Return node rotations `(F, M, 4)` float64 wxyz, identity at the first frame, continuous in time.

    From each frame to the next a node turns as its neighbours `points[:, neighbours[m]]` do about their mean (Kabsch
    1976), and the turns accumulate. `neighbours (M, K)`, `edge_mask (M, K)`, `points (F, P, 3)`: the nodes themselves
    or, better, all lifted tracks; `certain (F, P)`. A node whose valid neighbours are collinear, as two
    always are, keeps its rotation.
    """
    frames, nodes = len(points), len(neighbours)
    rotations = np.zeros((frames, nodes, 4))
    rotations[0] = quaternion.IDENTITY
    observed = np.ones(points.shape[:2], bool) if certain is None else certain
    for f in range(frames - 1):
        both = (observed[f] & observed[f + 1])[neighbours]
        weights = np.where(both, 1.0, _UNCERTAIN_WEIGHT) * edge_mask
        before, after = (points[g][neighbours].astype(np.float64) for g in (f, f + 1))  # (M, K, 3)
        turn, defined = _kabsch(before, after, weights)
        step = np.where(defined[:, None], quaternion.from_matrix(turn), quaternion.IDENTITY)
        rotations[f + 1] = quaternion.normalize(quaternion.multiply(step, rotations[f]))
    return quaternion.align_sequence(rotations)


def _kabsch(before: np.ndarray, after: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations `(M, 3, 3)` from `before` to `after (M, K, 3)`, and whether each is determined."""
    w = (weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12))[..., None]
    before, after = before - (w * before).sum(axis=1, keepdims=True), after - (w * after).sum(axis=1, keepdims=True)
    u, singular, vt = np.linalg.svd(np.swapaxes(w * after, 1, 2) @ before)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt, singular[:, 1] > COLLINEAR * np.maximum(singular[:, 0], np.finfo(np.float32).tiny)
