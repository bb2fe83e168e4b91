"""The exact weighted mean of rigid motions, which every blend of a deformation approximates. numpy, float64."""

from __future__ import annotations

import numpy as np

from f4x_core.geometry import pose, quaternion

ROUNDS, CONVERGED = 60, 1e-14
SMALL = 1e-4
"""Below this angle (radians) the series of the screw's coefficients are exact to rounding."""


def rigid_mean(q: np.ndarray, t: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions `(q (N,4), t (N,3))` around which the K logarithms cancel: `sum_k w_k log(mean^-1 motion_k) = 0` in SE(3).

    Kavan et al. 2008's iterative blending: it doesn't depend on the frame, and halves the screw between two motions. `q
    (N,K,4)` unit, `t (N,K,3)`, `weights (N,K)` that sum to 1; unique while no two motions are half a turn apart.
    """
    mean_q, mean_t = q[:, 0], t[:, 0]
    for _ in range(ROUNDS):
        inverse_q, inverse_t = pose.invert(mean_q, mean_t)
        turn, shift = logarithm(*pose.compose(inverse_q[:, None], inverse_t[:, None], q, t))
        turn, shift = ((weights[..., None] * part).sum(1) for part in (turn, shift))
        mean_q, mean_t = pose.compose(mean_q, mean_t, *exponential(turn, shift))
        mean_q = quaternion.normalize(mean_q)
        if max(np.abs(turn).max(initial=0), np.abs(shift).max(initial=0)) < CONVERGED:
            break
    return mean_q, mean_t


def logarithm(q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the screw `(turn (...,3), shift (...,3))` of motions, turning by no more than half a turn."""
    turn = quaternion.to_rotation_vector(q)
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    safe = np.where(angle < SMALL, 1.0, angle)
    bend = np.where(angle < SMALL, 1 / 12 + angle**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    once = np.cross(turn, t)
    return turn, t - once / 2 + bend * np.cross(turn, once)


def exponential(turn: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motions `(q, t)` of screws, the inverse of `logarithm`."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    safe = np.where(angle < SMALL, 1.0, angle)
    once = np.where(angle < SMALL, 1 / 2 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    twice = np.where(angle < SMALL, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    aside = np.cross(turn, shift)
    return quaternion.from_rotation_vector(turn), shift + once * aside + twice * np.cross(turn, aside)
