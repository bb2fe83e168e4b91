"""Moments of a scene drawn from the camera's path, from its side and from above, to judge the geometry and not only the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import trajectory
from ..geometry.camera import Camera
from ..progress import Progress, silent
from .model import Scene
from .view import render

RIGHT_DEGREES, ABOVE_DEGREES = 18.0, 20.0
"""Swing of the views aside about the scene's centre: enough to show a cut-out as one, little enough to recognise the clip."""
CENTRE_REGION = 3
"""The centre of the views aside lies at the median depth of the middle one of so many strips of the picture either way."""
CENTRE_DEPTH = (0.3, 1.5)
"""Bounds of that depth, world units: about a far sky or a speck before the lens no view can be swung."""


@dataclass(frozen=True)
class Moment:
    """The scene at one time, all pictures of one size."""

    index: int
    """Clip frame."""
    rgb: np.ndarray
    """(H,W,3) float32 in [0,1] or a little above, from the clip's camera."""
    depth: np.ndarray
    """(H,W) float32, world units, NaN where nothing is."""
    motion: np.ndarray
    """(H,W,2) float32, pixels to the next frame."""
    right: np.ndarray
    """(H,W,3) float32, from `right_degrees` to the right."""
    above: np.ndarray
    """(H,W,3) float32, from `above_degrees` above."""
    right_degrees: float = RIGHT_DEGREES
    above_degrees: float = ABOVE_DEGREES


def draw_moments(
    scene: Scene,
    indices: Sequence[int] | np.ndarray,
    right: float = RIGHT_DEGREES,
    above: float = ABOVE_DEGREES,
    backend: str = "auto",
    progress: Progress = silent,
) -> list[Moment]:
    """Draw clip frames `indices` from their own camera and from it swung `right` and `above` degrees about the scene's centre.

    F4xError: a missing backend.
    """

    def rgb(camera: Camera, time: float) -> np.ndarray:
        return render(scene, camera, time, ("rgb",), backend)["rgb"]

    moments = []
    for done, index in enumerate(indices):
        progress("moments", done, len(indices))
        cameras, time = scene.cameras, float(scene.cameras.times[index])
        own = render(scene, cameras[int(index)], time, ("rgb", "depth", "motion"), backend)
        centre = centre_depth(own["depth"])
        from_right = rgb(trajectory.aside(cameras, time, right=right, depth=centre).camera, time)
        from_above = rgb(trajectory.aside(cameras, time, up=above, depth=centre).camera, time)
        moments.append(
            Moment(int(index), own["rgb"], own["depth"], own["motion"], from_right, from_above, right, above)
        )
    progress("moments", len(indices), len(indices))
    return moments


def centre_depth(depth: np.ndarray) -> float:
    """Return the distance of the scene's centre: median of the middle of `depth (H,W)` within `CENTRE_DEPTH`; 1 if unknown."""
    height, width = depth.shape
    rows, columns = (slice(size // CENTRE_REGION, size - size // CENTRE_REGION) for size in (height, width))
    middle = depth[rows, columns]
    known = middle[np.isfinite(middle)]
    return float(np.clip(np.median(known), *CENTRE_DEPTH)) if len(known) else 1.0
