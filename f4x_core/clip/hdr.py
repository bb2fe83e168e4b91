"""Pictures of high dynamic range as sRGB: what phones write as HEVC with 10 bits, in HLG or PQ, with the primaries of BT.2020.

Reference: ITU-R BT.2408 puts graphics white at 203 cd/m2, 75 % HLG or 58 % PQ. That is sRGB's white here, so an sRGB colour that
was put into HLG or PQ at that level comes back. What is brighter is bent into the last of the range by FFmpeg's curve `mobius`.
"""

from functools import cache
from typing import Literal

import numpy as np

Transfer = Literal["hlg", "pq"]

WHITE = 203.0
"""Graphics white (cd/m2), ITU-R BT.2408."""
PEAK = 1000.0
"""Brightest light that is told from white (cd/m2): the nominal display of HLG in ITU-R BT.2100, and what phones master PQ for."""
KNEE = 0.8
"""Linear light, of white, up to which nothing is changed: sRGB 231. White itself becomes 244, twice as bright 252: so that a sky
or a lit wall keeps some of its shading where clipping would leave none, and all that is not white keeps its colour."""
LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)
"""Luminance of the primaries of BT.2020."""
TO_709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32)
"""Linear light from BT.2020's primaries to those of BT.709 and sRGB, ITU-R BT.2407."""
SYSTEM_GAMMA = 1.2
"""Gamma of HLG's OOTF for a display of `PEAK`, ITU-R BT.2100."""


def to_srgb(code: np.ndarray, transfer: Transfer) -> np.ndarray:
    """Return (H,W,3) uint8 sRGB of full-range `code (H,W,3)` uint16, R'G'B' of BT.2020 in `transfer`."""
    import cv2

    linear = _linear(transfer)[code]
    if transfer == "hlg":
        luminance = cv2.transform(linear, LUMA[None])
        linear *= cv2.pow(luminance, SYSTEM_GAMMA - 1)[..., None]
    linear = np.maximum(cv2.transform(linear, TO_709), 0) * np.float32(PEAK / WHITE)
    brightest = linear.max(axis=-1)
    bright = brightest > KNEE
    linear[bright] *= (_mobius(brightest[bright]) / brightest[bright])[:, None]  # one factor, so that the hue stays
    return _encoded()[np.minimum(linear * 65535 + 0.5, 65535).astype(np.uint16)]


def _mobius(light: np.ndarray) -> np.ndarray:
    """Compress light above `KNEE` below 1, which `PEAK` reaches; `tonemap_mobius` of FFmpeg's filter `tonemap`."""
    peak = PEAK / WHITE
    a = -(KNEE**2) * (peak - 1) / (KNEE**2 - 2 * KNEE + peak)
    b = (KNEE**2 - 2 * KNEE * peak + peak) / (peak - 1)
    light = np.minimum(light, peak)
    return (b + KNEE) ** 2 / (b - a) * (light + a) / (light + b)


@cache
def _linear(transfer: Transfer) -> np.ndarray:
    """Return (65536,) float32 linear light: of the scene (HLG) or the display (PQ), 1 = `PEAK`; ITU-R BT.2100 tables 4, 5."""
    code = np.arange(65536) / 65535
    if transfer == "hlg":
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(code <= 0.5, code**2 / 3, (np.exp((code - c) / a) + b) / 12)
    else:
        root = code ** (32 / 2523)
        ratio = np.maximum(root - 3424 / 4096, 0) / (2413 / 128 - 2392 / 128 * root)
        light = 10000 / PEAK * ratio ** (16384 / 2610)
    return light.astype(np.float32)


@cache
def _encoded() -> np.ndarray:
    """Return (65536,) uint8 sRGB of linear light 0 to 1, IEC 61966-2-1."""
    light = np.arange(65536) / 65535
    return np.round(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )
