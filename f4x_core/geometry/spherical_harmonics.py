"""Real spherical harmonics up to degree 4 in the basis, order and signs of 3D Gaussian Splatting (Kerbl et al. 2023).

Coefficients are `(N, S, 3)` with `S = (degree + 1)^2`; colour = max(sum of basis x coefficient + 0.5, 0).
"""

from functools import lru_cache

import numpy as np

from . import quaternion
from .arrays import Array, namespace, safe_norm

C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)); the others are the normalisations of their polynomials
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
C4 = (
    2.5033429417967046,
    1.7701307697799304,
    0.9461746957575601,
    0.6690465435572892,
    0.10578554691520431,
    0.47308734787878004,
    0.6258357354491761,
)
MAX_DEGREE = 4
_ROTATE_CHUNK = 8192  # Gaussians rotated at once: about 60 MB of float64 at degree 4


def dc_from_rgb(rgb: Array) -> Array:
    """Return the degree-0 coefficient that shows the colour `rgb` in [0, 1] from every side."""
    return (rgb - 0.5) / C0


def rgb_from_dc(dc: Array) -> Array:
    """Return the colour of a degree-0 coefficient (not clamped)."""
    return dc * C0 + 0.5


def degree_of(coefficients: int) -> int:
    """Return the degree whose basis has this many coefficients (1, 4, 9, 16 or 25)."""
    degree = round(coefficients**0.5) - 1
    if (degree + 1) ** 2 != coefficients or not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"{coefficients} spherical harmonics coefficients; expected 1, 4, 9, 16 or 25")
    return degree


def basis(directions: Array, degree: int) -> Array:
    """Return basis values `(..., S)` at `directions (..., 3)` of any length (a zero direction stays zero)."""
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"spherical harmonics degree {degree}; supported are 0 to {MAX_DEGREE}")
    directions = directions / safe_norm(directions)[0]
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    bands = [C0 + 0 * x]
    if degree >= 1:
        bands += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        bands += [C2[0] * xy, -C2[0] * yz, C2[1] * (2 * zz - xx - yy), -C2[0] * xz, C2[2] * (xx - yy)]
    if degree >= 3:
        bands += [
            -C3[0] * y * (3 * xx - yy),
            C3[1] * xy * z,
            -C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -C3[2] * x * (4 * zz - xx - yy),
            C3[4] * z * (xx - yy),
            -C3[0] * x * (xx - 3 * yy),
        ]
    if degree >= 4:
        bands += [
            C4[0] * xy * (xx - yy),
            -C4[1] * yz * (3 * xx - yy),
            C4[2] * xy * (7 * zz - 1),
            -C4[3] * yz * (7 * zz - 3),
            C4[4] * (zz * (35 * zz - 30) + 3),
            -C4[3] * xz * (7 * zz - 3),
            C4[5] * (xx - yy) * (7 * zz - 1),
            -C4[1] * xz * (xx - 3 * yy),
            C4[6] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return namespace(directions).stack(bands, axis=-1)


def evaluate(sh: Array, directions: Array) -> Array:
    """Return colours `(N, 3) >= 0` of `sh (N, S, 3)` seen along `directions (N, 3)` (camera to Gaussian)."""
    xp = namespace(sh, directions)
    values = basis(directions, degree_of(sh.shape[-2]))
    rgb = (values[..., None] * sh).sum(axis=-2) + 0.5
    return xp.where(rgb > 0, rgb, xp.zeros_like(rgb))


def seen_from(center: np.ndarray, means: np.ndarray, sh: np.ndarray, turn: np.ndarray | None = None) -> np.ndarray:
    """Return colours (N,3) >= 0 of Gaussians `means (N,3)`, `sh (N,S,3)` seen from `center (3,)`, all in one frame.

    `turn (N,4)` is the rotation of each Gaussian, with which its appearance turns: the view direction is taken into its own frame.
    """
    if sh.shape[1] == 1:
        return np.maximum(rgb_from_dc(sh[:, 0]), 0)
    directions: np.ndarray = means - center.astype(np.float32)
    if turn is not None:
        directions = quaternion.rotate(quaternion.conjugate(turn), directions)
    return evaluate(sh, directions)


def rotate(sh: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rotate the coloured sphere itself: `evaluate(rotate(sh, q), R d) == evaluate(sh, d)`.

    `sh (N, S, 3)`, `q (N, 4)` or `(4,)`; numpy, computed in float64, returned in the dtype of `sh`. The exact matrix
    of each band solves `B(x) M = B(R^-1 x)` on fixed well-spread directions x, where B spans the band exactly.
    """
    degree = degree_of(sh.shape[-2])
    q = np.broadcast_to(np.asarray(q, np.float64), (len(sh), 4))
    rotated = np.array(sh)
    for start in range(0, len(sh) if degree else 0, _ROTATE_CHUNK):
        part = slice(start, start + _ROTATE_CHUNK)
        directions = _fixed_directions(degree)
        turned_back = quaternion.rotate(quaternion.conjugate(q[part])[:, None], directions)  # (n, P, 3)
        values = basis(turned_back, degree)  # (n, P, S)
        for band in range(1, degree + 1):
            columns = slice(band**2, (band + 1) ** 2)
            wigner = _band_inverse(degree, band) @ values[..., columns]  # (n, 2 band + 1, 2 band + 1)
            rotated[part, columns] = wigner @ np.asarray(sh[part, columns], np.float64)
    return rotated


@lru_cache
def _fixed_directions(degree: int) -> np.ndarray:
    """Return `(2 (2 degree + 1), 3)` directions on a Fibonacci sphere."""
    count = 2 * (2 * degree + 1)
    z = 1 - (2 * np.arange(count) + 1) / count
    azimuth = np.arange(count) * np.pi * (3 - 5**0.5)
    return np.stack([np.cos(azimuth) * np.sqrt(1 - z * z), np.sin(azimuth) * np.sqrt(1 - z * z), z], axis=-1)


@lru_cache
def _band_inverse(degree: int, band: int) -> np.ndarray:
    """Return the pseudo-inverse `(2 band + 1, P)` of one band of the basis at the fixed directions."""
    return np.linalg.pinv(basis(_fixed_directions(degree), degree)[:, band**2 : (band + 1) ** 2])
