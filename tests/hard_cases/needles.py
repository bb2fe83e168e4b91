"""Needles.

Hard: Gaussians ten thousand times longer than wide, in any direction.

Why: the determinant of their projected covariance is the difference of two equal numbers; in float32 it is noise, and far
from the centre A dx^2 + 2 B dx dy + C dy^2 cancels too.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["scales"][:, 0] = 1.0
    scene["scales"][:, 1:] = 1e-4
    scene["opacities"] *= 0.3
    yield from compare(scene, picture=2e-4, gradient=1e-3)
