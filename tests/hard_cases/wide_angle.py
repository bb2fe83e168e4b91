"""A focal length of 0.2 picture widths.

Hard: an action camera's 136 degrees across.

Why: at the picture's edge perspective is steep; its linearisation is 6 times off there and splats smear.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import WIDTH, compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["means"][:, :2] *= 0.9 / 0.2
    scene["scales"] *= 0.9 / 0.2
    scene["K"][0, 0] = scene["K"][1, 1] = 0.2 * WIDTH
    yield from compare(scene)
