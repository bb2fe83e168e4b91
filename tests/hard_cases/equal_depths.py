"""Equal depths.

Hard: every Gaussian at the very same depth, overlapping.

Why: a sort that is not stable draws them in another order each time; a depth that differs by rounding differs by backend.

Must hold: ties go by index everywhere, and the picture is the same twice.
"""

from benchmarks.speed.raster import draw
from benchmarks.studies.hard_cases import that

from .common.drawing import backends, compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["means"][:, 2] = 2.0
    yield from compare(scene)
    for backend in backends():
        first, again = (draw(**scene, backend=backend).channels for _ in range(2))
        yield that("the same twice, bit for bit", first.equal(again), backend)
