"""Depth of every pixel, moving ones too, from Depth Anything V2 fitted to what the clip's geometry measured.

The model sees single pictures and gives inverse depth up to an unknown scale and shift; the classical provider measures static
pixels where the camera moves. Per frame, scale and shift come from a robust fit to the measurement, and what is left of the
difference is spread smoothly where the measurement is sure.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from torch.nn import functional

from ...priors import depth as classical
from ..memory import memory_guard
from ..preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor, input_size
from .loading import find, load, transformers

if TYPE_CHECKING:
    from ...clip import Clip
    from ...priors import Priors, PriorsConfig

INPUT_AREA = 518**2
"""Pixels of the model's input, as it was trained."""
TRUST, GUESS = 0.7, 0.3
"""Most confidence of the model's depth where the camera moves, and where nothing but the model knows about depth."""
AGREEMENT = 0.1
"""Median relative difference between model and measurement at which a frame keeps 1/e of that confidence."""
OUTLIER = 0.1
"""Cauchy scale of that difference in the fit."""
SPREAD, FLOOR = 1 / 16, 0.05
"""Width of the smoothing of the difference (picture widths), and the confidence below which it fades out."""
SAMPLING = 7
"""Every how many-th pixel takes part in the fit; a prime, so that all columns do."""
MAX_DEPTH = 50.0
"""Depths end at this many median depths: sky."""


class DepthAnything:
    """Pictures to relative inverse depth."""

    def __init__(self, model: str | Path | None = None) -> None:
        self.weights = find("depth-anything", model)
        self.model: Any = load(transformers.DepthAnythingForDepthEstimation, self.weights)

    def inverse_depth(self, rgb: np.ndarray) -> np.ndarray:
        """Return (H,W) float32 for a picture (H,W,3) uint8: larger is nearer, scale and shift unknown, differing between frames."""
        height, width = rgb.shape[:2]
        size = input_size(width, height, INPUT_AREA, self.model.config.patch_size)
        with torch.inference_mode(), memory_guard(f"Depth Anything on {size[1]} x {size[0]} pixels"):
            pixels = image_tensor(rgb, size, IMAGENET_MEAN, IMAGENET_STD, mode="bicubic")
            found = self.model(pixels).predicted_depth[:, None]  # (1,1,h,w)
            return functional.interpolate(found, (height, width), mode="bilinear", align_corners=False)[0, 0].numpy()


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Any, model: str | Path) -> None:
    """Provide the stage `depth` as `depth-anything`: the classical measurement, completed by the `model`.

    Fills `depth`, `depth_confidence` and sets the world unit like the classical one. Errors: F4xError without the weights.
    """
    network = DepthAnything(model)
    classical.provide(clip, priors, config, progress)
    assert priors.depth is not None and priors.depth_confidence is not None and priors.cameras is not None
    sure = priors.depth_confidence.astype(np.float32)
    if priors.mask is not None:
        sure[priors.mask] = 0.0  # plausible, not measured
    measured, seen, count = 1 / priors.depth, [], len(priors.frames)
    for index, frame in enumerate(priors.frames):
        progress("depth", index, count, "Depth Anything")
        seen.append(network.inverse_depth(clip.frames[frame]))
    progress("depth", count, count, "Depth Anything")
    relative = np.stack(seen)
    if priors.camera_kind == "moving":
        fitted = [fit_to_measurement(*frame) for frame in zip(relative, measured, sure, strict=True)]
        inverse = np.stack([depth for depth, _ in fitted])
        confidence = np.array([TRUST * np.exp(-difference / AGREEMENT) for _, difference in fitted])
        confidence = np.maximum(sure, confidence[:, None, None])
    else:
        # Nothing is measured: one scale and shift for the clip give the range of the ground-like guess.
        near, far = np.percentile(relative, (98, 2))
        guess_near, guess_far = np.percentile(measured, (98, 2))
        inverse = guess_far + (relative - far) / max(near - far, 1e-9) * (guess_near - guess_far)
        confidence = np.full(relative.shape, GUESS, np.float32)
    depth = 1 / np.maximum(inverse, np.median(inverse) / MAX_DEPTH)
    priors.store_depth(depth, confidence, float(np.median(depth)))
    priors.statistics["depth"]["model"] = network.weights.name


def fit_to_measurement(relative: np.ndarray, measured: np.ndarray, sure: np.ndarray) -> tuple[np.ndarray, float]:
    """Return a frame's inverse depth (H,W) from the model's `relative` one, and its median relative difference to the measurement.

    `measured (H,W)` inverse depth counts with the square of `sure (H,W)` 0..1. Scale and shift by least squares with Cauchy
    weights; a scale that is not positive means that the two contradict each other, and the measurement's mean is kept.
    """
    x, y, given = (values.reshape(-1)[::SAMPLING].astype(np.float64) for values in (relative, measured, sure**2))
    given = given + 1e-6
    # Slopes between random pairs and their median (Theil and Sen) to start with: least squares would follow outliers.
    other = np.random.default_rng(0).permutation(len(x))
    apart = abs(x - x[other]) > 0.1 * x.std()
    scale, mean_x, mean_y = 0.0, 0.0, float(weighted_median(y, given))
    if apart.any():
        slopes = ((y - y[other]) / np.where(apart, x - x[other], 1.0))[apart]
        scale = max(weighted_median(slopes, (given * given[other])[apart]), 0.0)
        mean_y = weighted_median(y - scale * x, given)
    for _ in range(10):
        difference = abs(y - mean_y - scale * (x - mean_x)) / np.maximum(y, 1e-9)
        weight = given / (1 + (difference / OUTLIER) ** 2)
        mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
        spread = np.average((x - mean_x) ** 2, weights=weight)
        scale = max(np.average((x - mean_x) * (y - mean_y), weights=weight) / max(spread, 1e-12), 0.0)
    fitted = (mean_y + scale * (relative - mean_x)).astype(np.float32)
    sigma = SPREAD * relative.shape[1]
    left, norm = (cv2.GaussianBlur(part, (0, 0), sigma) for part in ((measured - fitted) * sure, sure))
    return fitted + left / (norm + FLOOR), weighted_median(difference, given)


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the one of `values (n,)` that half of the `weights (n,)` lies below."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])
