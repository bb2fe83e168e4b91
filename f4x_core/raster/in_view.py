"""Finds the Gaussians that a camera can show: a cheap test before anything that costs memory for each. numpy alone."""

from __future__ import annotations

import math

import numpy as np

from ..geometry.camera import Camera
from ..geometry.splats import Splats
from .contract import FRUSTUM_MARGIN, RasterConfig

BLOCK = 1 << 16
"""Gaussians that are looked at together: all at once would cost what the test is there to save."""
SLACK_PIXELS, SLACK = 1.0, 1e-3
"""Pixels, and share of the distance from the picture's centre, that are added for the single precision of the backends."""


def in_view(splats: Splats, camera: Camera, config: RasterConfig | None = None, margin: float = 0.0) -> np.ndarray:
    """Return (N,) bool, False only where no backend draws anything of a Gaussian: behind the camera, or off the picture.

    Pictures without those are the same, bit for bit. The ellipse is taken to be as long everywhere as the longest axis may be
    seen, and opaque. `margin`: shares of the picture's width and height that the picture is larger on every side.
    """
    config = config or RasterConfig()
    starts = range(0, len(splats), BLOCK)
    blocks = [_in_view(splats.shape.take(slice(start, start + BLOCK)), camera, config, margin) for start in starts]
    return np.concatenate([np.zeros(0, bool), *blocks])


def _in_view(splats: Splats, camera: Camera, config: RasterConfig, margin: float) -> np.ndarray:
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    places = splats.means.astype(np.float64) @ rotation.T + translation  # (n,3)
    depth, longest = places[:, 2], splats.scales.max(1)
    seen = depth > config.near / 2  # in single precision it may be a hair further
    depth = np.where(seen, depth, 1.0)
    strongest = 2 * math.log(1 / config.alpha_min)  # squared radius, in standard deviations, of what is opaque
    for axis, size in enumerate((camera.width, camera.height)):
        focal, middle = camera.intrinsics[axis, axis], camera.intrinsics[axis, 2]
        outermost = (
            max(middle, size - middle) + FRUSTUM_MARGIN / 2 * size
        ) / focal  # where the projection is linearised
        variance = (focal / depth * longest) ** 2 * (1 + outermost**2) + config.blur
        off_centre = np.abs(focal * places[:, axis] / depth + middle - size / 2)
        reach = np.sqrt(strongest * variance) * (1 + SLACK) + SLACK_PIXELS
        seen &= off_centre * (1 - SLACK) <= reach + (0.5 + margin) * size
    return seen
