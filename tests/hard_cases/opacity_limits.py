"""Opacities at the edges of the rule.

Hard: all opacities 0, 1/255 (the cut), 0.9895, 0.99 (the clamp) or 1.

Why: log(0), a transmittance of 0 that cannot be divided by, and cuts that rounding moves.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import compare, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    for opacity in (0.0, 1 / 255, 0.9895, 0.99, 1.0):
        scene["opacities"] = torch.full_like(scene["opacities"], opacity)
        yield from compare(scene, gradient=1e-3)
