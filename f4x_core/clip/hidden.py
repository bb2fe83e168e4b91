"""Colours that alpha hides: nobody saw them, so nothing is fitted to them."""

from __future__ import annotations

import numpy as np

from .images import resize_color, resize_linear
from .pixels import SEEN

BLEED = 2
"""Pixels beside hidden ones that are not seen either: compression mixes both."""


def shrunk(
    pixels: np.ndarray, alpha: np.ndarray | None, width: int, height: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return `pixels (H,W,3)` averaged over the area of each new pixel as far as they are seen, and where they are hidden.

    The second is (height,width) bool, None where nothing is hidden. Hidden pixels are filled smoothly from around, so that
    nothing in them looks like an edge or a corner.
    """
    import cv2

    if alpha is None or (alpha >= SEEN).all():
        return resize_color(pixels, width, height), None
    side = 2 * BLEED + 1
    seen = cv2.erode((alpha >= SEEN).astype(np.float32), np.ones((side, side)))
    colours, weight = (resize_color(each, width, height) for each in (pixels * seen[..., None], seen))
    hidden = weight < 0.5
    filled = _filled(np.where(hidden[..., None], 0, colours), np.where(hidden, 0, weight))
    return np.round(filled).astype(np.uint8), hidden


def _filled(colours: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (H,W,3) float32 of sums `colours` of `weight (H,W)`; where that is 0, the mean of ever larger surroundings."""
    height, width = weight.shape
    known = weight > 0
    own = colours / np.maximum(weight, 1e-6)[..., None]
    if known.all() or max(height, width) < 2:
        return np.where(known[..., None], own, 127).astype(np.float32)
    half = (width + 1) // 2, (height + 1) // 2
    coarse = _filled(resize_color(colours, *half), resize_color(weight, *half))
    return np.where(known[..., None], own, resize_linear(coarse, width, height)).astype(np.float32)
