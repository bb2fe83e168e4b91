"""False colours for what is not a colour: depth and motion. Give one range per clip, or the pictures flicker."""

from collections.abc import Iterable

import numpy as np

SPECTRUM = np.array(
    [
        (0.18, 0.07, 0.28),
        (0.26, 0.42, 0.92),
        (0.12, 0.78, 0.85),
        (0.35, 0.97, 0.42),
        (0.83, 0.92, 0.22),
        (0.99, 0.61, 0.18),
        (0.85, 0.22, 0.04),
        (0.45, 0.02, 0.02),
    ]
)
"""Dark violet over blue, green and yellow to dark red: turbo-like, even in brightness steps."""
WHEEL_AT = np.array([0, 15, 21, 25, 36, 49, 55]) / 55
WHEEL = np.array([(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1), (1, 0, 0)], float)
"""Hues of directions in the proportions of the Middlebury flow wheel (Baker et al. 2011): right is red, down yellow,
left cyan-blue, up violet."""


def depth_range(depths: Iterable[np.ndarray], outliers: float = 2.0) -> tuple[float, float]:
    """Return (near, far) of a clip's depth maps without the `outliers` percent at either end; NaN is unknown.

    (1, 2) when no depth is known.
    """
    known = [depth[np.isfinite(depth) & (depth > 0)] for depth in depths]
    values = np.concatenate([np.zeros(0), *known])
    if not len(values):
        return 1.0, 2.0
    near, far = np.percentile(values, [outliers, 100 - outliers])
    return float(near), float(far)


def colour_depth(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Return (H,W,3) uint8 of `depth (H,W)`: near red, far violet, unknown (NaN) black.

    Colours are even in 1 / depth, which is how far apart two depths look.
    """
    known = np.isfinite(depth) & (depth > 0)
    inverse = 1 / np.where(known, depth, 1)
    position = (inverse - 1 / far) / max(1 / near - 1 / far, 1e-12)
    return _bytes(_ramp(position, np.linspace(0, 1, len(SPECTRUM)), SPECTRUM) * known[..., None])


def colour_motion(motion: np.ndarray, largest: float) -> np.ndarray:
    """Return (H,W,3) uint8 of `motion (H,W,2)` in pixels: hue is the direction, white no motion, full colour `largest`.

    Longer motion is darkened, so that it tells itself apart; unknown (NaN) is black.
    """
    known = np.isfinite(motion).all(axis=-1)
    motion = np.where(known[..., None], motion, 0)
    length = np.linalg.norm(motion, axis=-1) / max(largest, 1e-12)
    turn = np.arctan2(motion[..., 1], motion[..., 0]) / (2 * np.pi) % 1  # (H, W), 0 right, 1/4 down
    hue = _ramp(turn, WHEEL_AT, WHEEL)
    colour = 1 - np.minimum(length, 1)[..., None] * (1 - hue)
    beyond = np.where(length > 1, 0.75, 1.0)
    return _bytes(colour * (beyond * known)[..., None])


def _ramp(position: np.ndarray, at: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Colours (...,3) at `position (...)`, linear between `colours (n,3)` that stand at `at (n,)`, held at the ends."""
    return np.stack([np.interp(position, at, colours[:, channel]) for channel in range(3)], axis=-1)


def _bytes(rgb: np.ndarray) -> np.ndarray:
    return np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
