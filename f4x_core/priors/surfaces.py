"""Samples of flow and tracks joined by the sweep: which surface a pixel belongs to, and where surfaces end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .sweep import Samples, Swept

SWEPT_NOISE, SWEPT_NOISE_PX = 0.02, 0.15
"""Errors of a swept inverse depth: a fraction of it, and pixels in the farthest compared frame; half the distance of two planes
is the third."""
CONTRADICTION = 2.0
"""Errors of the sweep from which a sample of flow is of another surface than the swept one."""
HARDLY, CLEARLY = 1.0, 4.0
"""Grey levels by which a contradicting sweep must explain the pictures better to count at all, and in full."""
UNRELIABLE = 1.3
"""Median difference from flow, on textured surfaces and in errors of the sweep, at which the sweep of a frame counts by half.
A train has .4 to .7, a run beside a fence .4 to .9; a bedroom, whose lens bends and whose bed moves, 1.7 to 3 and is wrong."""
TRUSTED = 25.0
"""Relative precision, 1 / (relative error)^2, at which steps of the swept surfaces and grey levels count alike."""
TRUST_BLUR = 1.5
"""Samples over which that trust is smoothed."""
SURFACE_STEP = 0.03
"""Relative step of swept inverse depth that weakens smoothness by 1/e."""


@dataclass(frozen=True)
class Joined:
    """Samples of flow, tracks and sweep."""

    inverse: np.ndarray
    """(h, w)."""
    precision: np.ndarray
    """(h, w): 1 / variance, 0 = unknown."""
    trust: np.ndarray
    """(h, w) 0..1: how far the steps of the swept surface are trusted."""


def join(samples: Samples, swept: Swept, free: np.ndarray) -> Joined:
    """Join samples of a frame with swept ones where other frames confirm these and nothing moves, `free (h, w)`.

    Flow that contradicts the sweep lies on the other side of a silhouette and is left out, if the sweep explains the pictures
    clearly better: on plain surfaces it does not, and errs more.
    """
    surface, error = swept.inverse, errors(swept)
    contradicted = (abs(samples.inverse - surface) > CONTRADICTION * error) & (samples.precision > 0)
    better = np.clip((swept.better - HARDLY) / (CLEARLY - HARDLY), 0, 1)
    sure = reliability(samples, swept) * (swept.known & free) * np.where(contradicted, better, 1)
    added = sure * samples.held / error**2
    trust = added * surface**2 / (added * surface**2 + TRUSTED)
    measured = samples.precision * (1 - trust * contradicted)
    total = measured + added
    mean = (measured * samples.inverse + added * surface) / np.maximum(total, 1e-12)
    return Joined(np.where(total > 0, mean, samples.inverse), total, trust)


def errors(swept: Swept) -> np.ndarray:
    """Return (h, w) standard deviation of swept inverse depth."""
    pixel = SWEPT_NOISE_PX / np.maximum(swept.gain, 1e-9)
    return np.sqrt((SWEPT_NOISE * swept.inverse) ** 2 + pixel**2 + (swept.spacing / 2) ** 2)


def reliability(samples: Samples, swept: Swept) -> float:
    """Return 0..1: the trust in the sweep of a frame, by its median difference from flow on textured surfaces, in its errors.

    Where the lens bends, the shutter rolls or hardly anything shifts, the sweep fits what it finds.
    """
    compared = swept.known & (samples.precision > 0) & (samples.held > 0.5)
    if not compared.any():
        return 0.0
    off = float(np.median((abs(samples.inverse - swept.inverse) / errors(swept))[compared]))
    return 1 / (1 + (off / UNRELIABLE) ** 8)


def surface_guide(swept: Swept, trust: np.ndarray, free: np.ndarray, looks: np.ndarray) -> np.ndarray:
    """Return (h, w, 3) guide of `depth.fill_inverse_depth`, with grey levels `looks (h, w)`.

    Behind moving objects, where it is not `free (h, w)`, surfaces go on smoothly.
    """
    inverse = np.where(free, swept.inverse, pyramid_mean(swept.inverse, trust * free))
    levels = np.log(np.maximum(inverse, 1e-9)) / SURFACE_STEP
    return np.stack([levels, ndimage.gaussian_filter(trust, TRUST_BLUR), looks], -1).astype(np.float32)


def pyramid_mean(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return normalised convolution from coarse to fine: known values stay, holes take the mean of a growing neighbourhood."""
    import cv2

    floor = 1e-3 * float(weight[weight > 0].mean()) if (weight > 0).any() else 1.0
    total, norm = (values * weight).astype(np.float64), weight.astype(np.float64)
    pyramid = [(total, norm)]
    while min(pyramid[-1][0].shape) > 2:
        pyramid.append((cv2.pyrDown(pyramid[-1][0]), cv2.pyrDown(pyramid[-1][1])))
    total, norm = pyramid[-1]
    mean = np.full_like(total, total.sum() / norm.sum()) if norm.sum() > 0 else np.ones_like(total)
    for total, norm in reversed(pyramid):
        mean = cv2.resize(mean, total.shape[::-1], interpolation=cv2.INTER_LINEAR)
        mean = (total + floor * mean) / (norm + floor)
    return mean
