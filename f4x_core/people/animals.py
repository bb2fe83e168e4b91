"""A second opinion on doubtful people: the classifier that knows ImageNet's animals. Swans and dogs have limbs, too."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ..errors import F4xError

if TYPE_CHECKING:
    import torch

ANIMALS = 398
"""The first classes of ImageNet are animals."""
SIDE = 224
"""Pixels of the square that the classifier sees."""
GREY = (124, 116, 104)
"""Mean color of ImageNet's pictures, around the body."""


def animal_likelihood(picture: np.ndarray, mask: np.ndarray) -> float | None:
    """Likelihood 0..1 that the masked part of a picture is an animal; None where the classifier is not installed.

    picture: (H, W, 3) uint8. mask: (H, W) bool, not empty.
    """
    import cv2

    network = _classifier()
    if network is None:
        return None
    import torch

    from ..features.preprocess import image_tensor

    body = cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    alone = np.where(body[..., None], picture, np.array(GREY, np.uint8))
    y, x = np.nonzero(mask)
    half = int(max(np.ptp(y), np.ptp(x))) // 2 + 6
    row, column = (int(y.min()) + int(y.max())) // 2, (int(x.min()) + int(x.max())) // 2
    padded = np.pad(alone, ((half, half), (half, half), (0, 0)), constant_values=GREY[1])
    square = np.ascontiguousarray(padded[row : row + 2 * half, column : column + 2 * half])
    with torch.inference_mode():
        features = network.extract_features(image_tensor(square, (SIDE, SIDE), (0.5,) * 3, (0.5,) * 3))  # type: ignore[operator]
        return float(network._fc(features.mean((2, 3))).softmax(-1)[0, :ANIMALS].sum())  # type: ignore[operator]


@cache
def _classifier() -> torch.nn.Module | None:
    """EfficientNet-Lite0, loaded once; None where its packages are absent."""
    from ..features.offline import load_classifier

    try:
        return load_classifier()
    except F4xError:
        return None
