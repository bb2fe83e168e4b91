"""A random walker with priors on a grid of pixels. Needs numpy alone."""

from __future__ import annotations

import numpy as np


def walk_with_prior(
    bonds: tuple[np.ndarray, np.ndarray], prior: np.ndarray, fixed: np.ndarray, trust: float
) -> np.ndarray:
    """Return (h,w) float32 in [0, 1]: a random walker with `prior (h,w)` (Grady 2005) between 4-neighbours.

    `argmin sum bond (x_i - x_j)^2 + trust sum (x_i - prior_i)^2` with `bonds` (h-1,w) down and (h,w-1) across, by conjugate
    gradients; x is `fixed (h,w)` where that is not NaN.
    """
    down, across = bonds
    free = np.isnan(fixed)

    def apply(x: np.ndarray) -> np.ndarray:
        result = trust * x
        flow = down * np.diff(x, axis=0)
        result[1:] += flow
        result[:-1] -= flow
        flow = across * np.diff(x, axis=1)
        result[:, 1:] += flow
        result[:, :-1] -= flow
        return result

    x = np.where(free, prior, fixed).astype(np.float64)
    residual = (trust * prior - apply(x)) * free
    direction, power = residual.copy(), (residual**2).sum()
    for _ in range(500):
        if power < 1e-10:
            break
        image = apply(direction) * free
        step = power / (direction * image).sum()
        x += step * direction
        residual -= step * image
        before, power = power, (residual**2).sum()
        direction = residual + power / before * direction
    return np.clip(x, 0, 1).astype(np.float32)
