"""A scaffold at rest, with nodes in one place.

Hard: nothing moves, and two nodes share every position.

Why: all losses of the scaffold are norms of differences that are 0, whose derivative is 0/0.

Must hold: losses are 0, gradients are finite, and optimising leaves the scaffold where it is.
"""

import numpy as np
import torch

from benchmarks.studies.hard_cases import that, within
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.losses import ArapEdges, arap_losses, smoothness_losses
from f4x_core.scaffold.optimise import GeometryConfig, optimise_geometry

STAGE = "scaffold"


def check():
    rng = np.random.default_rng(0)
    places = rng.normal(size=(6, 3)).astype(np.float32)
    places[1] = places[0]
    neighbours = (np.arange(6)[:, None] + np.arange(4)) % 6
    mask = np.ones((6, 4), bool)
    quat = np.tile(np.float32([1, 0, 0, 0]), (5, 6, 1))
    for dtype in (torch.float32, torch.float64):
        xyz = torch.tensor(places, dtype=dtype).repeat(5, 1, 1).requires_grad_()
        turns = torch.tensor(quat, dtype=dtype, requires_grad=True)
        edges = ArapEdges.build(neighbours, mask, dtype=dtype)
        loss = sum(arap_losses(xyz, turns, edges)) + sum(smoothness_losses(xyz, turns))
        loss.backward()
        yield within("losses", loss.detach(), 1e-6, str(dtype)[6:])
        yield that("gradients are finite", xyz.grad.isfinite().all() and turns.grad.isfinite().all(), str(dtype)[6:])
    scaffold = Scaffold(
        np.arange(5.0),
        np.repeat(places[None], 5, 0),
        quat,
        np.full(6, 0.3, np.float32),
        np.ones((5, 6), bool),
        np.arange(6),
        neighbours,
        mask,
        0.3,
    )
    settled = optimise_geometry(scaffold, GeometryConfig(steps=20))
    yield within("it stays, world units", abs(settled.xyz - scaffold.xyz).max(), 0.05)
    yield that("rotations are finite", np.isfinite(settled.quat).all())
