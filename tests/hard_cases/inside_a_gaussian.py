"""The camera inside a large Gaussian.

Hard: centres just in front of the camera, ten times as large as their distance.

Why: the linearisation of perspective holds for small footprints only; the ellipse covers more than the picture.

Must hold: nothing blows up; picture and gradients are those of float64.
"""

from .common.drawing import compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["means"][:8, 2] = 0.03
    scene["means"][:8, :2] *= 0.01
    scene["scales"][:8] = 0.3
    scene["opacities"][:8] = 0.2
    yield from compare(scene, gradient=1e-3)
