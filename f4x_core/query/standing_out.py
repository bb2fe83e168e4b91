"""How much the Gaussians that move differ from the background behind them. Needs numpy alone.

A scene can be drawn without what moves. A thing differs from what is then seen in its place. A shadow, a ripple or a reflection
is the same surface, hardly changed or only darker, as subtracting a background in film tells shadows from things (Horprasert,
Harwood and Davis 1999; Prati et al. 2003).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.camera import Camera
from ..scene import Scene
from ..scene.view import render
from .blend_weights import sums_over_views, view_size
from .pixels import SHOWN
from .segmentation import sums_around
from .superpixels import OPPONENT

DARKEST = 0.3
"""A shadow leaves at least so much of the brightness (sRGB) of what it falls on."""
BEHIND = 0.9
"""Where less than this alpha of the background is drawn, nobody knows what is behind: all differs fully."""
BLACK = 1e-3
"""Squared brightness, summed over 3x3 pixels, of a background on which no shadow shows."""
ROWS = 2
"""Pixels of a thing above, and below, of what it holds between them."""


def difference(scene: Scene, views: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) float64 each: the blend weights of the Gaussians, and these times how `unlike` the background their pixels are.

    In pixels of the clip's pictures, means over at most `views` views of the clip, drawn `columns` wide.
    """
    still, moves = Scene("background", scene.static, scene.cameras), scene.moving.any()

    def differs(camera: Camera, time: float) -> np.ndarray:
        if not moves:
            return np.ones((camera.height, camera.width))
        behind, here = render(still, camera, time, ("rgb", "alpha")), render(scene, camera, time, ("rgb",))
        return np.where(behind["alpha"] > BEHIND, unlike(here["rgb"], behind["rgb"]), 1)

    return _means(scene, views, columns, differs)


def between(scene: Scene, thing: np.ndarray, views: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) float64 each: as `difference`, of pixels that have something of `thing (N,)` bool above and below."""

    def within(camera: Camera, time: float) -> np.ndarray:
        shown = render(scene, camera, time, (), values={"thing": thing[:, None].astype(np.float32)})["thing"][..., 0]
        above = np.cumsum(shown > SHOWN, 0)
        return (above >= ROWS) & (above[-1] - above >= ROWS)

    return _means(scene, views, columns, within)


def _means(
    scene: Scene, views: int, columns: int, draw: Callable[[Camera, float], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) each: blend weights, and these times the values (H,W) that `draw` returns for their pixels."""
    cameras = scene.cameras

    def layers(frame: int, size: tuple[int, int]) -> np.ndarray:
        drawn = draw(cameras[frame].resized(size[1], size[0]), float(cameras.times[frame]))
        return np.stack([np.ones_like(drawn), drawn], -1, dtype=np.float32)

    pixels = min(views, len(cameras)) * np.prod(view_size(scene, columns))
    sums = sums_over_views(scene, views, columns, layers) * (cameras.width * cameras.height / pixels)
    return sums[:, 0], sums[:, 1]


def unlike(picture: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return (H,W) float64: the difference of sRGB pictures `(H,W,3)`, 0 = none, 1 = black from white.

    The background may be darkened by one factor in the 3x3 pixels around: that is what a shadow does.
    """
    picture, background = (np.clip(part.astype(float), 0, 1) for part in (picture, background))
    both, alone = (sums_around(part * background).mean(-1, keepdims=True) for part in (picture, background))
    light = np.clip(both / np.maximum(alone, BLACK), DARKEST, 1)
    return np.abs((picture - light * background) @ OPPONENT.T).max(-1)
