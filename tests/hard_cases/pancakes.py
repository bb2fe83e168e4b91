"""Pancakes seen on edge.

Hard: flat discs of no thickness whose plane goes through the camera.

Why: the projection has rank 1; without a blur its inverse does not exist.

Must hold: each leaves the footprint of a pixel's width; picture and gradients are those of float64.
"""

from .common.drawing import compare, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["scales"][:, 2] = 0
    yield from compare(scene)
    scene["quats"] = torch.tensor([[0.70710678, 0.70710678, 0, 0]]).repeat(len(scene["means"]), 1)
    scene["means"][:, 1] *= 0.02  # the discs' planes nearly hold the camera
    yield from compare(scene, gradient=5e-4)
