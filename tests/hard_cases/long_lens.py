"""A focal length of 5 picture widths.

Hard: a telephoto lens of 11 degrees across; everything is far away.

Why: pixels are large multiples of x/z, whose rounding is multiplied alike.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import WIDTH, compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["means"][:, 2] *= 20
    scene["means"][:, :2] *= 20 * 0.9 / 5
    scene["scales"] *= 20 * 0.9 / 5
    scene["K"][0, 0] = scene["K"][1, 1] = 5 * WIDTH
    yield from compare(scene)
