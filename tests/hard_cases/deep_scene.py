"""Depths over five decades.

Hard: dust before the lens and mountains behind, from 0.02 to 2000 world units in one picture.

Why: depths are sorted by their bits or in buckets; buckets as wide as the range put near things in one.

Must hold: the order is right to the last step; picture and gradients are those of float64.
"""

from .common.drawing import compare, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    depth = torch.logspace(-1.7, 3.3, len(scene["means"]))[
        torch.randperm(80, generator=torch.Generator().manual_seed(0))
    ]
    factor = (depth / scene["means"][:, 2])[:, None]
    scene["means"] *= factor
    scene["scales"] *= factor
    yield from compare(scene, gradient=2e-4)
