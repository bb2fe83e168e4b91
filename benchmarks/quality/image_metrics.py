"""Likeness of pictures as the field's benchmarks compute it, each by its own definition; numpy and scipy."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import correlate1d, uniform_filter

K1, K2 = 0.01, 0.03
"""SSIM's stabilising constants (Wang et al. 2004), in shares of the range of values."""
UNIFORM_WINDOW = 7
"""Side of the window in scikit-image's `structural_similarity`, its default."""
GAUSSIAN_WINDOW, GAUSSIAN_SIGMA = 11, 1.5
"""Those of DyCheck's masked SSIM."""


def psnr_bytes(image: np.ndarray, target: np.ndarray) -> float:
    """PSNR (dB) of uint8 pictures (H,W,3): `cv2.PSNR`, the NVIDIA protocol's; infinite where they are equal."""
    error = float(np.mean((image.astype(np.float64) - target) ** 2))
    return math.inf if error == 0 else 10 * math.log10(255**2 / error)


def ssim_bytes(image: np.ndarray, target: np.ndarray) -> float:
    """SSIM of uint8 pictures (H,W,3) as the NVIDIA protocol has it: `skimage.metrics.structural_similarity`, its defaults.

    Uniform windows of 7 pixels, sample covariance, windows that leave the picture left out, mean of the channels.
    """
    x, y = image.astype(np.float64), target.astype(np.float64)
    size = (UNIFORM_WINDOW, UNIFORM_WINDOW, 1)
    sample = UNIFORM_WINDOW**2 / (UNIFORM_WINDOW**2 - 1)
    mean_x, mean_y = uniform_filter(x, size), uniform_filter(y, size)
    var_x = sample * (uniform_filter(x * x, size) - mean_x**2)
    var_y = sample * (uniform_filter(y * y, size) - mean_y**2)
    covariance = sample * (uniform_filter(x * y, size) - mean_x * mean_y)
    inside = UNIFORM_WINDOW // 2
    return float(_similarity(mean_x, mean_y, var_x, var_y, covariance, 255)[inside:-inside, inside:-inside].mean())


def masked_psnr(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    """PSNR (dB) of pictures (H,W,3) in [0,1] over the pixels of `mask` (H,W) bool (DyCheck's mPSNR); NaN where none."""
    if not mask.any():
        return math.nan
    error = float(np.mean((image[mask].astype(np.float64) - target[mask]) ** 2))
    return math.inf if error == 0 else -10 * math.log10(error)


def masked_ssim(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    """SSIM of pictures (H,W,3) in [0,1] over the pixels of `mask` (H,W) bool: DyCheck's mSSIM, by partial convolution.

    As there, windows in which no pixel counts are in the mean, as 1: only figures of equal masks can be compared.
    """
    x, y = image.astype(np.float64), target.astype(np.float64)
    mean_x, mean_y = _partial_blur(x, mask), _partial_blur(y, mask)
    var_x = np.maximum(_partial_blur(x * x, mask) - mean_x**2, 0)
    var_y = np.maximum(_partial_blur(y * y, mask) - mean_y**2, 0)
    covariance = _partial_blur(x * y, mask) - mean_x * mean_y
    covariance = np.sign(covariance) * np.minimum(np.sqrt(var_x * var_y), np.abs(covariance))
    return float(_similarity(mean_x, mean_y, var_x, var_y, covariance, 1).mean())


def score_confusion(confusion: np.ndarray) -> tuple[float, float]:
    """Return (mIoU, accuracy) of counts (L, L or more): true label, found label; a column from L on is no label.

    The mean is over labels that are true or found somewhere.
    """
    count = len(confusion)
    hits = np.diag(confusion)
    union = confusion.sum(1) + confusion[:, :count].sum(0) - hits
    return float((hits[union > 0] / union[union > 0]).mean()), float(hits.sum() / confusion.sum())


def _similarity(
    mean_x: np.ndarray, mean_y: np.ndarray, var_x: np.ndarray, var_y: np.ndarray, covariance: np.ndarray, span: float
) -> np.ndarray:
    """SSIM at every pixel (Wang et al. 2004, Eq. 13); `span` is the range of values."""
    c1, c2 = (K1 * span) ** 2, (K2 * span) ** 2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    return luminance * (2 * covariance + c2) / (var_x + var_y + c2)


def _partial_blur(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Gaussian mean of `values (H,W,3)` over the pixels of `mask`, along rows, then columns (Liu et al. 2018, Eq. 1).

    Each of the two passes weighs by the number of pixels that count, and a pixel counts for the second if the first saw one.
    """
    offsets = np.arange(GAUSSIAN_WINDOW) - GAUSSIAN_WINDOW // 2
    kernel = np.exp(-0.5 * (offsets / GAUSSIAN_SIGMA) ** 2)
    kernel /= kernel.sum()
    weight = mask[..., None].astype(np.float64)
    half = GAUSSIAN_WINDOW // 2
    for axis in (1, 0):
        inside = [slice(None)] * 3
        inside[axis] = slice(half, -half)
        blurred = correlate1d(values * weight, kernel, axis, mode="constant")[tuple(inside)]
        count = correlate1d(weight, np.ones(GAUSSIAN_WINDOW), axis, mode="constant")[tuple(inside)]
        values = np.where(count > 0.5, blurred * GAUSSIAN_WINDOW / np.maximum(count, 1), 0)
        weight = (count > 0.5).astype(np.float64)
    return values
