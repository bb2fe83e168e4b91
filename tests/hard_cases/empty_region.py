"""Losses and scores over empty regions.

Hard: a mask without a pixel, a frame without any known depth, a picture smaller than SSIM's window.

Why: means over nothing are 0/0, and a NaN loss ends a fit.

Must hold: a loss of exactly 0 with gradient 0; a score over nothing says NaN and not a number.
"""

import math

import torch

from benchmarks.studies.hard_cases import that
from f4x_core.fit.losses import depth_loss, masked_l1, rgb_loss
from f4x_core.metrics.pictures import psnr

STAGE = "losses"


def check():
    picture = torch.rand(6, 7, 3, generator=torch.Generator().manual_seed(0), requires_grad=True)
    nowhere, unknown = torch.zeros(6, 7), torch.full((6, 7), torch.nan)
    loss = masked_l1(picture, torch.rand(6, 7, 3), nowhere)
    loss = loss + depth_loss(picture[..., 0], picture[..., 1], unknown, torch.ones(6, 7))
    loss.backward()
    yield that("no region, no loss", loss.item() == 0 and not picture.grad.any())
    yield that("no region, no score", math.isnan(psnr(picture, picture, nowhere)))
    small = rgb_loss(picture, torch.rand(6, 7, 3), torch.ones(6, 7), 0.3)
    yield that("smaller than SSIM's window", small.isfinite())
    same = psnr(picture.detach(), picture.detach())
    yield that("a perfect picture's score is no NaN", not math.isnan(same) and same > 60)
