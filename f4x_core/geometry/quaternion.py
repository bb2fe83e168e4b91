"""Quaternions `(..., 4)` in order w, x, y, z, numpy or torch, any floating dtype, broadcasting over leading axes.

Every function has finite gradients everywhere, the identity and half turns included. A zero quaternion counts as the
identity. `rotate` and `to_matrix` accept quaternions of any length; the others keep the length rules of their formula.
"""

import numpy as np

from .arrays import Array, cross, like, namespace, safe_norm

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])

# Below these squared magnitudes the truncated series are exact to float64 rounding, while the closed forms are 0/0.
_EXP_SERIES_BELOW = 1e-4
_LOG_SERIES_BELOW = 1e-5


def normalize(q: Array) -> Array:
    """Return unit quaternions `(..., 4)`; a quaternion shorter than 1e-12 becomes the identity."""
    norm, valid = safe_norm(q)
    return namespace(q).where(valid, q / norm, like(IDENTITY.astype(_dtype(q)), q))


def conjugate(q: Array) -> Array:
    """Return `(w, -x, -y, -z)`: the inverse of a unit quaternion."""
    return q * like(np.array([1.0, -1.0, -1.0, -1.0], _dtype(q)), q)


def multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product `(..., 4)`: the rotation `b` followed by the rotation `a`."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return namespace(a, b).stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors `v (..., 3)` by `q (..., 4)` of any length."""
    w, u = q[..., :1], q[..., 1:]
    uv = cross(u, v)
    return v + _two_over_squared_norm(q) * (w * uv + cross(u, uv))


def to_matrix(q: Array) -> Array:
    """Return rotation matrices `(..., 3, 3)` of quaternions of any length."""
    xp = namespace(q)
    s = _two_over_squared_norm(q)[..., 0]
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(matrix: Array) -> Array:
    """Return unit quaternions `(..., 4)`, w >= 0, of rotation matrices `(..., 3, 3)`.

    `4 q q^T` is linear in the matrix; its row with the largest diagonal entry is a well-conditioned multiple of `q`
    (Shepperd 1978), so there is no square root of a difference and the gradient is finite at every rotation.
    """
    xp = namespace(matrix)
    m = [[matrix[..., i, j] for j in range(3)] for i in range(3)]
    wx, wy, wz = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    xy, xz, yz = m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]
    ww = 1 + m[0][0] + m[1][1] + m[2][2]
    xx = 1 + m[0][0] - m[1][1] - m[2][2]
    yy = 1 - m[0][0] + m[1][1] - m[2][2]
    zz = 1 - m[0][0] - m[1][1] + m[2][2]
    rows = [[ww, wx, wy, wz], [wx, xx, xy, xz], [wy, xy, yy, yz], [wz, xz, yz, zz]]
    outer = xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)  # (..., 4, 4)
    best = xp.argmax(xp.stack([ww, xx, yy, zz], axis=-1), axis=-1)[..., None]  # (..., 1)
    chosen = like(np.arange(4), best) == best  # (..., 4) one-hot
    q = normalize(xp.where(chosen[..., None], outer, xp.zeros_like(outer)).sum(axis=-2))
    return xp.where(q[..., :1] < 0, -q, q)


def from_rotation_vector(v: Array) -> Array:
    """Return unit quaternions `(..., 4)` of rotation vectors `(..., 3)` in radians."""
    xp = namespace(v)
    squared = (v * v).sum(axis=-1, keepdims=True)
    small = squared < _EXP_SERIES_BELOW
    angle = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    w = xp.where(small, 1 - squared / 8 + squared * squared / 384, xp.cos(angle / 2))
    scale = xp.where(small, 0.5 - squared / 48 + squared * squared / 3840, xp.sin(angle / 2) / angle)
    return xp.concatenate([w, v * scale], axis=-1)


def to_rotation_vector(q: Array) -> Array:
    """Return rotation vectors `(..., 3)` in radians, no longer than pi, of quaternions of any length but zero."""
    xp = namespace(q)
    q = xp.where(q[..., :1] < 0, -q, q)
    w, u = q[..., :1], q[..., 1:]
    squared = (u * u).sum(axis=-1, keepdims=True)
    small = squared <= _LOG_SERIES_BELOW * w * w
    safe_w = xp.where(small & (w > 0), w, xp.ones_like(w))
    norm = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    ratio = squared / (safe_w * safe_w)  # tan^2 of the half angle
    series = 2 * (1 - ratio / 3 + ratio * ratio / 5) / safe_w
    return u * xp.where(small, series, 2 * xp.arctan2(norm, w) / norm)


def slerp(a: Array, b: Array, fraction: Array | float) -> Array:
    """Interpolate unit quaternions along the shorter arc; `fraction` is a number or `(..., 1)`, 0 gives `a`, 1 `b`."""
    return multiply(a, from_rotation_vector(fraction * to_rotation_vector(multiply(conjugate(a), b))))


def align_sequence(q: Array, axis: int = 0) -> Array:
    """Flip signs along `axis` (time) so that neighbours lie on one hemisphere; the first entry keeps its sign."""
    xp = namespace(q)
    q = xp.moveaxis(q, axis, 0)
    dots = (q[1:] * q[:-1]).sum(axis=-1, keepdims=True)
    signs = xp.where(dots < 0, -xp.ones_like(dots), xp.ones_like(dots))
    aligned = xp.concatenate([q[:1], q[1:] * xp.cumprod(signs, axis=0)], axis=0)
    return xp.moveaxis(aligned, 0, axis)


def _two_over_squared_norm(q: Array) -> Array:
    """Return `2 / |q|^2 (..., 1)`, and 0 for a zero quaternion, which therefore rotates nothing."""
    xp = namespace(q)
    squared = (q * q).sum(axis=-1, keepdims=True)
    valid = squared > 1e-24
    return xp.where(valid, 2 / xp.where(valid, squared, xp.ones_like(squared)), xp.zeros_like(squared))


def _dtype(q: Array) -> np.dtype:
    """Return the dtype for constants: that of a numpy input, so float32 stays float32; `like` casts for torch."""
    return q.dtype if isinstance(q, np.ndarray) else np.dtype(np.float64)


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (F,) in radians between rotation matrices (F,3,3); one of the two may be (3,3)."""
    # |A - B|_F = sqrt(8) sin(angle/2): exact for small angles too, where the arc cosine of the trace is not.
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=(1, 2)) / np.sqrt(8), 0, 1))
