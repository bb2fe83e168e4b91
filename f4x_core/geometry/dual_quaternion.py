"""Unit dual quaternions `(..., 8)`: real part wxyz, then dual part wxyz; a rigid motion that can be averaged.

Kavan et al. 2008, "Geometric Skinning with Approximate Dual Quaternion Blending". numpy or torch.
"""

import numpy as np

from . import quaternion
from .arrays import Array, like, namespace, safe_norm

IDENTITY = np.array([1.0, 0, 0, 0, 0, 0, 0, 0])


def from_pose(q: Array, t: Array) -> Array:
    """Return `(p, d)` with `p = q` (unit quaternion) and `d = (0, t) q / 2`."""
    xp = namespace(q, t)
    pure = xp.concatenate([xp.zeros_like(t[..., :1]), t], axis=-1)
    dual = 0.5 * quaternion.multiply(pure, q)
    return xp.concatenate([q + xp.zeros_like(dual), dual], axis=-1)


def normalize(dq: Array, eps: float = 1e-4) -> Array:
    """Return the unit dual quaternion `(..., 8)`: `p / n` and `d / n - p (p . d) / n^3` with `n = |p|`.

    Where `n <= eps` (rotations that cancelled out) the result is the identity.
    """
    xp = namespace(dq)
    norm, valid = safe_norm(dq[..., :4], eps)
    real, dual = dq[..., :4] / norm, dq[..., 4:] / norm
    dual = dual - real * (real * dual).sum(axis=-1, keepdims=True)
    identity = like(IDENTITY.astype(dq.dtype) if xp is np else IDENTITY, dq)
    return xp.where(valid, xp.concatenate([real, dual], axis=-1), identity)


def to_pose(dq: Array) -> tuple[Array, Array]:
    """Return `(q (..., 4), t (..., 3))` of unit dual quaternions: `t = 2 (d p*)_vec`."""
    real, dual = dq[..., :4], dq[..., 4:]
    return real, 2 * quaternion.multiply(dual, quaternion.conjugate(real))[..., 1:]


def multiply(a: Array, b: Array) -> Array:
    """Return the motion `b` followed by the motion `a`."""
    ap, ad, bp, bd = a[..., :4], a[..., 4:], b[..., :4], b[..., 4:]
    dual = quaternion.multiply(ap, bd) + quaternion.multiply(ad, bp)
    return namespace(a, b).concatenate([quaternion.multiply(ap, bp), dual], axis=-1)
