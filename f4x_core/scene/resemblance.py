"""Compares a picture with a scene's render: a cheap check that a clip belongs to a scene."""

import numpy as np

from ..clip.model import Picture, cut
from .model import Scene
from .view import render

WIDTH = 48
"""Pixels across at which pictures are compared: what things look like in the large."""
ALIKE = 0.7
"""Correlation from which on a picture is of the scene. Of twelve fitted clips their own have 0.85 or more, others' 0.57 or less."""


def resemblance(scene: Scene, time: float, brightness: np.ndarray) -> float:
    """Return the correlation of a frame's `brightness (H,W)` with that of the scene at clip `time`; 0 where one is uniform.

    Bars that were cut off the clip are cut off here, too.
    """
    brightness = cut(brightness, Picture.read(scene.provenance.get("picture")))
    camera = scene.cameras.at(time)
    width = min(WIDTH, camera.width, brightness.shape[1])
    height = max(1, min(round(width * camera.height / camera.width), brightness.shape[0]))
    drawn = render(scene, camera.resized(width, height), time, ("rgb",))["rgb"].mean(-1)
    pair = np.stack([drawn.ravel(), _shrunk(brightness, height, width).ravel()]).astype(np.float64)
    pair -= pair.mean(1, keepdims=True)
    norms = np.linalg.norm(pair, axis=1)
    return float(pair[0] @ pair[1] / norms.prod()) if norms.min() > 0 else 0.0


def _shrunk(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return the means of `height` x `width` blocks of an image (H,W)."""
    for axis, count in ((0, height), (1, width)):
        edges = np.linspace(0, image.shape[axis], count + 1).astype(int)
        sizes = np.diff(edges).reshape((-1, 1) if axis == 0 else (1, -1))
        image = np.add.reduceat(image, edges[:-1], axis=axis) / sizes
    return image
