"""Values of pictures of any type as 8-bit sRGB."""

from __future__ import annotations

import numpy as np

SEEN = 128
"""Alpha (of 255) from which a pixel is seen."""
BITS = (10, 12)
"""Bits of values that cameras write into 16 bits without making them larger."""
WHITE = 65535
"""Largest value of 16 bits."""
TOLERANCE = 0.01
"""By which floats may leave 0 to 1: resampling overshoots."""


def as_8_bit(values: np.ndarray, white: int = WHITE) -> np.ndarray:
    """Return uint8 of `values`: uint8 as they are, uint16 up to `white`, floats from 0 to 1; ValueError for all others."""
    if values.dtype == np.uint8:
        return values
    if values.dtype == np.uint16:
        return np.round(np.minimum(values, white) * np.float32(255 / white)).astype(np.uint8)
    if values.dtype.kind != "f":
        raise ValueError(f"values of type {values.dtype}, and 8 or 16 bits without a sign are wanted")
    least, most = float(values.min()), float(values.max())
    if not (least >= -TOLERANCE and most <= 1 + TOLERANCE):
        raise ValueError(f"floating-point values from {least:.3g} to {most:.3g}, and 0 to 1 is wanted")
    return np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)


def white_of(largest: int) -> int:
    """Return the value of white in 16-bit pictures whose `largest` value is known."""
    return next((2**bits - 1 for bits in BITS if largest < 2**bits), WHITE)
