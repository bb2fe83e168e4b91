"""Rigid motions as (quaternion `(..., 4)` wxyz, translation `(..., 3)`): `x_world = R x_local + t`. numpy or torch."""

import numpy as np

from . import quaternion
from .arrays import Array, namespace


def compose(qa: Array, ta: Array, qb: Array, tb: Array) -> tuple[Array, Array]:
    """Return pose `a` after pose `b`: `x -> Ra (Rb x + tb) + ta`."""
    return quaternion.multiply(qa, qb), quaternion.rotate(qa, tb) + ta


def invert(q: Array, t: Array) -> tuple[Array, Array]:
    """Return the inverse of a pose with a unit quaternion."""
    inverse = quaternion.conjugate(q)
    return inverse, -quaternion.rotate(inverse, t)


def transform(q: Array, t: Array, x: Array) -> Array:
    """Apply the pose to points `x (..., 3)`."""
    return quaternion.rotate(q, x) + t


def from_matrix(matrix: Array) -> tuple[Array, Array]:
    """Return (unit quaternion with w >= 0, translation) of rigid matrices `(..., 4, 4)`."""
    return quaternion.from_matrix(matrix[..., :3, :3]), matrix[..., :3, 3]


def to_matrix(q: Array, t: Array) -> Array:
    """Return rigid matrices `(..., 4, 4)`."""
    xp = namespace(q, t)
    top = xp.concatenate([quaternion.to_matrix(q), t[..., None]], axis=-1)  # (..., 3, 4)
    zeros = xp.zeros_like(top[..., :1, :3])
    return xp.concatenate([top, xp.concatenate([zeros, xp.ones_like(zeros[..., :1])], axis=-1)], axis=-2)


def align_similarity(
    p: np.ndarray, q: np.ndarray, weights: np.ndarray | None = None, with_scale: bool = True
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return `(s, R (3, 3), t (3,))` minimising `sum w |q - (s R p + t)|^2` (Umeyama 1991, eq. 40-43).

    `p`, `q (N, 3)` are matching points, `weights (N,)` non-negative. `R` is a proper rotation even for mirrored or
    planar points; points that all coincide in `p` give scale 1. numpy, float64.
    """
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    w = np.ones(len(p)) if weights is None else np.asarray(weights, np.float64)
    w = (w / max(w.sum(), np.finfo(np.float64).tiny))[:, None]
    p_mean, q_mean = (w * p).sum(0), (w * q).sum(0)
    p_centred, q_centred = p - p_mean, q - q_mean
    u, singular, vt = np.linalg.svd((w * q_centred).T @ p_centred)  # covariance (3, 3), q rows, p columns
    reflection = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * reflection) @ vt
    variance = (w * p_centred**2).sum()
    scale = float(singular @ reflection / variance) if with_scale and variance > 0 else 1.0
    return scale, rotation, q_mean - scale * rotation @ p_mean
