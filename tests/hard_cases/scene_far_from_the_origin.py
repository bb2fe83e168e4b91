"""A scene a thousand sizes away from the origin.

Hard: scene and camera stand together at (1000, 0, 0), as in a city's coordinates.

Why: the camera's z is the small difference of large numbers: at 1000 a float32 steps by 6e-5.

Must hold: no worse than that step allows: 6e-5 world units are 0.002 pixels here.
"""

from benchmarks.speed.raster import draw
from benchmarks.studies.hard_cases import that

from .common.drawing import compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["means"][:, 0] += 1000
    scene["viewmat"][0, 3] = -1000
    yield from compare(scene, picture=2e-3, gradient=1e-2)
    yield that("something is seen", draw(**scene).alpha.max() > 0.5)
