"""How much the Gaussians that move differ from the background behind them. Needs numpy alone.

A scene can be drawn without what moves. A thing differs from what is then seen in its place. A shadow, a ripple or a reflection
is the same surface, hardly changed or only darker, as subtracting a background in film tells shadows from things (Horprasert,
Harwood and Davis 1999; Prati et al. 2003).
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..scene import Scene
from ..scene.view import render
from .blend_weights import blend_weight_sums
from .segmentation import sums_around
from .superpixels import OPPONENT

DARKEST = 0.3
"""A shadow leaves at least so much of the brightness (sRGB) of what it falls on."""
BEHIND = 0.9
"""Where less than this alpha of the background is drawn, nobody knows what is behind: all differs fully."""
BLACK = 1e-3
"""Squared brightness, summed over 3x3 pixels, of a background on which no shadow shows."""


def difference(scene: Scene, views: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """(weights, differences), (N,) float64 each: the blend weights of the Gaussians, and these times how `unlike` their pixels are.

    In pixels of the clip's pictures, means over at most `views` views of the clip, drawn `columns` wide.
    """
    cameras, still = scene.cameras, Scene("background", scene.static, scene.cameras)
    height = max(1, round(columns * cameras.height / cameras.width))
    frames, sums = evenly_spaced(len(cameras), views), np.zeros((len(scene.ids), 2))
    for frame in frames:
        time, camera = float(cameras.times[frame]), cameras[int(frame)].resized(columns, height)
        layers = np.ones((height, columns, 2), np.float32)
        if scene.moving.any():
            behind = render(still, camera, time, ("rgb", "alpha"))
            here = render(scene, camera, time, ("rgb",))["rgb"]
            layers[..., 1] = np.where(behind["alpha"] > BEHIND, unlike(here, behind["rgb"]), 1)
        sums += blend_weight_sums(scene, time, int(frame), layers)
    sums *= cameras.width * cameras.height / (columns * height * len(frames))
    return sums[:, 0], sums[:, 1]


def unlike(picture: np.ndarray, background: np.ndarray) -> np.ndarray:
    """(H,W) float64: how much sRGB pictures `(H,W,3)` differ, 0 = not at all, 1 = black from white.

    The background may be darkened by one factor in the 3x3 pixels around: that is what a shadow does.
    """
    picture, background = (np.clip(part.astype(float), 0, 1) for part in (picture, background))
    both, alone = (sums_around(part * background).mean(-1, keepdims=True) for part in (picture, background))
    light = np.clip(both / np.maximum(alone, BLACK), DARKEST, 1)
    return np.abs((picture - light * background) @ OPPONENT.T).max(-1)
