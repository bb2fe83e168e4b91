"""Colours: the core speaks sRGB; Blender's attributes, glTF's COLOR_0 and USD's displayColor speak linear light."""

import numpy as np


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Return linear Rec.709 of sRGB values in [0, 1], any shape (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.0) + 0.055) / 1.055) ** 2.4)


def srgb_slope(linear: np.ndarray) -> np.ndarray:
    """Return the derivative of `srgb_from_linear`."""
    return np.where(linear <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(linear, 0.0031308) ** (1 / 2.4 - 1))


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Return the inverse of `linear_from_srgb`."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055)
