"""Gaussians around the near plane.

Hard: centres from just behind the camera to just in front of it, some exactly on the near plane.

Why: 1/z explodes, and which side of the plane a centre lies on is a matter of rounding.

Must hold: what is not in front is not drawn; what is comes out as in float64.
"""

from .common.drawing import compare, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    depths = torch.tensor([-1.0, -1e-6, 0.0, 1e-8, 0.009, 0.01, 0.0101, 0.02, 0.05, 0.1])
    scene["means"][:, 2] = depths.repeat(len(scene["means"]) // len(depths))
    scene["means"][:, :2] *= 0.02
    scene["scales"] *= 0.02
    yield from compare(scene, picture=1e-4, gradient=1e-3)
