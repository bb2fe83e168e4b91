"""Colours seen from the Gaussian's own centre, and along the poles.

Hard: the camera stands in the middle of a Gaussian, or exactly above it.

Why: the direction from which it is seen is 0/0, and angles around a pole have no direction.

Must hold: colours and gradients are finite, in float32 those of float64.
"""

import torch

from benchmarks.studies.hard_cases import that, within
from f4x_core.gaussians import appearance
from f4x_core.native.kernels import TORCH, Kernels

STAGE = "raster"


def check():
    generator = torch.Generator().manual_seed(0)
    means = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 0, -1], [1e-20, 0, 0], [1e6, 0, 0]], dtype=torch.float64)
    sh = torch.randn(5, 16, 3, generator=generator, dtype=torch.float64)
    quats = torch.randn(5, 4, generator=generator, dtype=torch.float64)
    true = appearance(sh, means, quats, torch.zeros(3, dtype=torch.float64))
    for by, kernels in (("torch", TORCH), ("native", Kernels(native=True))):
        leaves = [x.float().requires_grad_() for x in (sh, means, quats)]
        colours = appearance(*leaves, torch.zeros(3), kernels)
        # Float32 cannot tell 1e-20 from the centre; what matters there is that it stays finite.
        error = (colours.detach().double() - true)[[1, 2, 4]].abs().max()
        yield within("colours", error, 1e-5, by)
        colours.sum().backward()
        finite = colours.isfinite().all() and all(leaf.grad.isfinite().all() for leaf in leaves)
        yield that("colours and gradients are finite", finite, by)
