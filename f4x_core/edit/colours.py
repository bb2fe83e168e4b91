"""Colour mathematics of edits, on the colours that Gaussians have in their SH: sRGB numbers, about [0, 1].

Light, hue and saturation are those of OKLab (Ottosson 2020): L, a, b of a colour are linear in the cube roots of its cone
responses, so that scaling all three darkens a colour as shade does, and equal steps look equal.
"""

from __future__ import annotations

import numpy as np

from ..geometry import spherical_harmonics
from ..scene.color import linear_from_srgb, srgb_from_linear, srgb_slope
from .styles import StyleColors

CONES_FROM_LINEAR = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
LAB_FROM_CONES = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
DARKEST = 1e-3
"""OKLab light below which a colour has no hue that could be scaled."""
HIGHLIGHT = 0.4
"""Fraction of what is brighter than the mean that a painted thing keeps: a strong colour has little room above it."""
SLACK = 1e-4
"""By so much a linear colour may leave [0, 1] before it counts as one that no screen shows: rounding, invisible."""
HALVINGS = 8
"""Steps of the search for the strongest tint that is shown: to 0.4 %, half a step of a byte."""
MIN_CONTRAST = 0.3
"""A look is spread over the lights of a selection, but over no less than this, or noise would get all its colours."""
TAILS = (2, 98)
"""Percentiles between which the lights of a selection lie; a few odd Gaussians do not count."""
WARM = (0.02, 0.08)
"""OKLab a and b that full warmth adds to white: towards the light of a candle, black stays black."""
MAX_SPREAD_RATIO = 3.0
"""A spread of colours is carried over by no larger factor, or the few tints of a grey thing would glare."""
MIN_SPREAD = 1e-3
"""OKLab; a selection of one colour has no spread to be scaled."""


def lab_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """Return OKLab (…,3) float64 of sRGB (…,3); numbers below 0 count as 0."""
    linear = linear_from_srgb(np.maximum(np.asarray(rgb, np.float64), 0))
    return np.cbrt(linear @ CONES_FROM_LINEAR.T) @ LAB_FROM_CONES.T


def rgb_from_lab(lab: np.ndarray) -> np.ndarray:
    """Return sRGB (n,3) float64 in [0, 1] of OKLab (n,3); a color beyond sRGB keeps lightness and hue and loses saturation."""
    lab = np.concatenate([np.clip(lab[:, :1], 0, 1), lab[:, 1:]], 1)
    odd = np.flatnonzero(~_is_shown(_linear(lab)))
    low, high = np.zeros((len(odd), 1)), np.ones((len(odd), 1))
    for _ in range(HALVINGS if len(odd) else 0):
        factor = (low + high) / 2
        shown = _is_shown(_linear(lab[odd] * np.concatenate([np.ones_like(factor), factor, factor], 1)))[:, None]
        low, high = np.where(shown, factor, low), np.where(shown, high, factor)
    lab[odd, 1:] *= low
    return srgb_from_linear(np.clip(_linear(lab), 0, 1))


def _linear(lab: np.ndarray) -> np.ndarray:
    return (lab @ np.linalg.inv(LAB_FROM_CONES).T) ** 3 @ np.linalg.inv(CONES_FROM_LINEAR).T


def _is_shown(linear: np.ndarray) -> np.ndarray:
    return ((linear > -SLACK) & (linear < 1 + SLACK)).all(-1)


def colours_of(sh: np.ndarray) -> np.ndarray:
    """Return the sRGB (n,3) float64 of the constant part of `sh (n,S,3)`; it can leave [0, 1]."""
    return spherical_harmonics.rgb_from_dc(sh[:, 0].astype(np.float64))


def exposed(rgb: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return `rgb (n,3)` sRGB with `factor (3,)` times the linear light, and the slope (n,3) of the new colors over the old.

    Nothing is clipped at white until a picture is drawn, so that a stop down takes a stop up back.
    """
    before = linear_from_srgb(rgb)
    after = before * factor
    return srgb_from_linear(after), factor * srgb_slope(after) / srgb_slope(before)


def mean_of(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the mean over the rows of `values (n,…)` by `weights (n,) >= 0`; the plain mean where all are 0."""
    return np.average(values, 0, weights if weights.any() else None)


def painted(rgb: np.ndarray, target: np.ndarray, lightness: np.ndarray | float) -> np.ndarray:
    """Return `target (3,)` sRGB, darker and brighter (n,3) as each of `rgb (n,3)` is darker or brighter than OKLab `lightness`."""
    shade = lab_from_rgb(rgb)[:, :1] / np.maximum(lightness, DARKEST)
    return rgb_from_lab(np.where(shade > 1, 1 + HIGHLIGHT * (shade - 1), shade) * lab_from_rgb(target))


def with_hue(rgb: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return sRGB (n,3) with hue and saturation of `target (3,)` and the lightness of `rgb (n,3)`; a black target gives gray."""
    goal = lab_from_rgb(target)
    if goal[0] < DARKEST:
        goal = np.array([1.0, 0, 0])
    return rgb_from_lab(lab_from_rgb(rgb)[:, :1] * goal / goal[0])


def graded(
    rgb: np.ndarray, contrast: float, saturation: float, warmth: float, lightness: float, hue: float = 0.0
) -> np.ndarray:
    """Return `rgb (n,3)` sRGB graded in OKLab.

    Lightness is spread about `lightness` by `contrast`, saturation is scaled, hues are turned by `hue` degrees, and `warmth` is
    added.
    """
    lab = lab_from_rgb(rgb)
    light = lightness + contrast * (lab[:, :1] - lightness)
    tint = saturation * lab[:, 1:]
    if hue:
        cos, sin = np.cos(np.deg2rad(hue)), np.sin(np.deg2rad(hue))
        tint = tint @ np.array([[cos, sin], [-sin, cos]])
    tint = tint + warmth * np.array(WARM) * np.clip(light, 0, 1)
    return rgb_from_lab(np.concatenate([light, tint], 1))


def lights_of(rgb: np.ndarray) -> tuple[float, float]:
    """Return the centre and the range of the OKLab lightness of `rgb (n,3)`, without their `TAILS`."""
    low, high = np.percentile(lab_from_rgb(rgb)[:, 0], TAILS)
    return (low + high) / 2, max(high - low, MIN_CONTRAST)


def styled(rgb: np.ndarray, look: StyleColors, centre: float, extent: float) -> np.ndarray:
    """Return sRGB (n,3) from the ramp of `look`, by the lightness of `rgb (n,3)`; the ramp spans `extent` of it about `centre`."""
    ramp = lab_from_rgb(np.array(look.ramp))
    place = np.clip((lab_from_rgb(rgb)[:, 0] - centre) / extent + 0.5, 0, 1) * (len(ramp) - 1)
    return rgb_from_lab(np.stack([np.interp(place, np.arange(len(ramp)), channel) for channel in ramp.T], -1))


def moments_of(rgb: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation (3,) in OKLab of `rgb (n,3)`, weighted by `weights (n,)`."""
    lab = lab_from_rgb(rgb)
    mean = mean_of(lab, weights)
    return mean, np.sqrt(mean_of((lab - mean) ** 2, weights))


def matched(rgb: np.ndarray, own: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return `rgb (n,3)` sRGB with the moments `own` changed to `other`, channel by channel (Reinhard et al. 2001)."""
    factor = np.where(own[1] < MIN_SPREAD, 1, np.minimum(other[1] / np.maximum(own[1], MIN_SPREAD), MAX_SPREAD_RATIO))
    return rgb_from_lab((lab_from_rgb(rgb) - own[0]) * factor + other[0])
