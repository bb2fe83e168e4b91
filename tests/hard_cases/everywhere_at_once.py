"""Gaussians that cover everything.

Hard: some are twenty times larger than the picture and touch every tile.

Why: lists of tiles overflow, and footprints are clamped to the picture.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import compare, wavy

STAGE = "raster"


def check():
    scene = wavy(40, 90, 70)
    scene["scales"][:8] = 20.0
    scene["opacities"][:8] = 0.1
    yield from compare(scene)
