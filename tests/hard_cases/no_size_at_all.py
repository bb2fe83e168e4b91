"""Gaussians of no size.

Hard: standard deviations of 0, of the smallest float32, of 1e-30.

Why: covariance 0 has no inverse, and its determinant underflows long before.

Must hold: the footprint of a pixel remains; picture and gradients are those of float64.
"""

from benchmarks.speed.raster import draw
from benchmarks.studies.hard_cases import that

from .common.drawing import compare, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    for scale in (0.0, 1e-42, 1e-30):
        scene["scales"] = torch.full_like(scene["scales"], scale)
        yield from compare(scene)
    yield that("something is seen", draw(**scene).alpha.max() > 0.1)
