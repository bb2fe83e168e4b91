"""Turns pictures into the tensors that models take, and maps from one grid to another. Needs torch alone, no torchvision."""

from __future__ import annotations

from math import sqrt

import numpy as np
import torch
from torch.nn import functional

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def input_size(width: int, height: int, area: int, multiple: int) -> tuple[int, int]:
    """Return (h, w) of about `area` pixels, in multiples of the model's stride, nearest to the picture's aspect ratio."""
    scale = sqrt(area / (width * height))
    h, w = (max(1, round(side * scale / multiple)) * multiple for side in (height, width))
    return h, w


def image_tensor(
    rgb: np.ndarray,
    size: tuple[int, int],
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0),
    std: tuple[float, float, float] = (1.0, 1.0, 1.0),
    mode: str = "bilinear",
) -> torch.Tensor:
    """Return a picture (H,W,3) uint8 as (1,3,h,w) float32, `(rgb / 255 - mean) / std`, stretched to `size` (h, w).

    Resized as the models were trained: anti-aliased when shrinking, rounded to whole levels (processors resize uint8).
    """
    x = torch.from_numpy(np.require(rgb, requirements=["C", "W"])).permute(2, 0, 1)[None].float()
    if x.shape[-2:] != torch.Size(size):
        x = functional.interpolate(x, size, mode=mode, align_corners=False, antialias=True).round().clamp(0, 255)
    mean_, std_ = (torch.tensor(value).view(1, 3, 1, 1) for value in (mean, std))
    return (x / 255 - mean_) / std_


def resize_map(features: torch.Tensor, size: tuple[int, int], resize: str = "bilinear") -> torch.Tensor:
    """Return the features (B,C,H,W) at another grid (h, w) by the rule of a `FeatureSpec`; differentiable."""
    if features.shape[-2:] == torch.Size(size):
        return features
    if resize == "area":
        return functional.interpolate(features, size, mode="area")
    return functional.interpolate(features, size, mode="bilinear", align_corners=False, antialias=True)
