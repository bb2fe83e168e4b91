"""Pictures of one pixel, one row, one column.

Hard: sizes below a tile, and no multiple of it.

Why: edges of tiles and of vector lanes are where indices go wrong.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import compare, wavy

STAGE = "raster"


def check():
    for width, height in ((1, 1), (61, 1), (1, 45), (17, 16)):
        yield from compare(wavy(60, width, height))
