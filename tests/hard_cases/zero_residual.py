"""A picture that is already right.

Hard: rendered and true picture are the same, pixel for pixel.

Why: the derivatives of |x|, of sqrt(x^2) and of SSIM's quotient of variances are 0/0 there.

Must hold: the picture losses are least, their gradients finite and, by central differences in float64, right.
"""

import torch

from benchmarks.studies.hard_cases import that, within
from f4x_core.fit.losses import depth_loss, masked_l1, rgb_loss
from f4x_core.metrics.pictures import ssim_map

STAGE = "losses"


def check():
    generator = torch.Generator().manual_seed(0)
    true = torch.rand(14, 15, 3, generator=generator, dtype=torch.float64)
    weight = torch.ones(14, 15, dtype=torch.float64)
    for what, picture in {"equal": true, "both black": 0 * true, "both flat": 0 * true + 0.5}.items():
        for dtype in (torch.float32, torch.float64):
            image = picture.to(dtype).clone().requires_grad_()
            loss = rgb_loss(image, picture.to(dtype), weight.to(dtype), 0.3)
            loss.backward()
            yield within(f"{what}: loss", loss.detach().abs(), 1e-6, str(dtype)[6:])
            yield within(f"{what}: gradient", image.grad.abs().max().nan_to_num(nan=1), 1e-6, str(dtype)[6:])
    image = true.clone().requires_grad_()
    right = torch.autograd.gradcheck(lambda x: ssim_map(x, true).mean(), (image,), raise_exception=False)
    yield that("SSIM's gradient by differences", right, "float64")
    depth = true[..., 0].clone().requires_grad_()
    loss = depth_loss(depth, weight, true[..., 0], weight) + masked_l1(image, true, weight)
    loss.backward()
    yield that("depth and L1: finite", depth.grad.isfinite().all() and image.grad.isfinite().all(), "float64")
