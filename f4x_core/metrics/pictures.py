"""Likeness of pictures: peak signal-to-noise ratio and structural similarity."""

import math
from functools import lru_cache

import torch
from torch import Tensor

# SSIM's stabilising constants for images in [0, 1] (Wang et al. 2004).
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
SSIM_WINDOW, SSIM_SIGMA = 11, 1.5


@lru_cache(maxsize=8)
def ssim_window(dtype: torch.dtype) -> Tensor:
    """Return (11,) the blur, summing to 1."""
    offsets = torch.arange(SSIM_WINDOW, dtype=torch.float64) - (SSIM_WINDOW - 1) / 2
    kernel = torch.exp(-(offsets**2) / (2 * SSIM_SIGMA**2))
    return (kernel / kernel.sum()).to(dtype)


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Return the structural similarity (C,H,W) of two images (H,W,C): Gaussian window of 11 pixels, zero padding."""
    x, y = image.permute(2, 0, 1), target.permute(2, 0, 1)  # (C,H,W)
    channels = len(x)
    maps = torch.cat([x, y, x * x + y * y, x * y])[None]  # (1,4C,H,W): the two variances are only needed as a sum
    window = ssim_window(image.dtype)
    across = window.view(1, 1, 1, -1).repeat(4 * channels, 1, 1, 1)
    down = across.transpose(2, 3)
    half = SSIM_WINDOW // 2
    blurred = torch.nn.functional.conv2d(maps, across, padding=(0, half), groups=4 * channels)
    blurred = torch.nn.functional.conv2d(blurred, down, padding=(half, 0), groups=4 * channels)[0]
    mean_x, mean_y, squares, product = blurred.split(channels)
    mean_squares = mean_x * mean_x + mean_y * mean_y
    covariance = product - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_squares + SSIM_C1)
    return luminance * (2 * covariance + SSIM_C2) / (squares - mean_squares + SSIM_C2)


def psnr(image: Tensor, target: Tensor, weight: Tensor | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB of images (H,W,3) in [0,1], over the pixels of `weight` (H,W); NaN for none."""
    error = ((image - target) ** 2).mean(-1)
    if weight is None:
        mse = float(error.mean())
    else:
        total = float(weight.sum())
        if total < 1:
            return math.nan
        mse = float((error * weight).sum()) / total
    return -10 * math.log10(max(mse, 1e-12))


def ssim(image: Tensor, target: Tensor) -> float:
    """Return the mean structural similarity of two images (H,W,3)."""
    return float(ssim_map(image, target).mean())
