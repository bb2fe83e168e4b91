"""Image losses of the photometric stage. Every loss is 0 on an empty mask instead of dividing by zero."""

from typing import NamedTuple

import torch
from torch import Tensor

from ..metrics.pictures import SSIM_C1, SSIM_C2, ssim_map, ssim_window
from ..native.kernels import TORCH, Kernels
from .frame_native import FrameMaps, FrameWeights, NativeFrameLosses, Supervision
from .picture_native import Comparison, NativePictureLoss

# Composited depth is not divided by less than this.
MIN_DEPTH = 1e-3
# Below this many pixels (or this much weight) a masked mean says nothing.
MIN_WEIGHT = 1e-6


ROUGHNESS_STEPS = 68
"""Steps of the second difference of depth in the shorter side of a picture: 4 pixels of 270, a few Gaussians."""
PLAIN = 0.04
"""Second difference of grey, 1 = white, at which a surface is textured and tells its depth itself."""


def masked_l1(image: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Return the sum over channels of |image - target| (H,W,C), averaged over pixels with `weight` (H,W)."""
    return ((image - target).abs().sum(-1) * weight).sum() / weight.sum().clamp_min(MIN_WEIGHT)


def rgb_loss(
    image: Tensor,
    target: Tensor,
    weight: Tensor,
    ssim_weight: float,
    kernels: Kernels = TORCH,
) -> Tensor:
    """L1 (summed over channels) + `ssim_weight` * (1 - SSIM), both averaged over pixels with `weight` (H,W).

    Images (H,W,3) in [0,1]. SSIM is its mean over channels. The compiled library compares them where
    `kernels` say so (float32 on the CPU).
    """
    if kernels.native and ssim_weight:
        comparison = Comparison(ssim_window(image.dtype), SSIM_C1, SSIM_C2, ssim_weight, kernels.threads)
        total = NativePictureLoss.apply(image, target, weight, comparison)
        return total / weight.sum().clamp_min(MIN_WEIGHT)
    loss = masked_l1(image, target, weight)
    if ssim_weight:
        unlike = ((1 - ssim_map(image, target).mean(0)) * weight).sum()
        loss = loss + ssim_weight * unlike / weight.sum().clamp_min(MIN_WEIGHT)
    return loss


class FrameFactors(NamedTuple):
    """Weights of the losses of a frame's pixels, as in `LossConfig`."""

    ssim: float
    moving: float
    depth: float
    roughness: float
    mask: float


def frame_losses(
    rendered: tuple[Tensor, Tensor, Tensor], maps: FrameMaps, factors: FrameFactors, threads: int
) -> Tensor:
    """Weighted sum of the losses that compare channels (H,W,C), depth and alpha (H,W) with a frame, by the compiled library.

    Channels are rgb and, with a weight of the mask, the alpha of moving objects; others send no gradient. What is compared, and
    the plain form of each loss, is in `loss_terms`.
    """
    step = roughness_step(*maps.prior.shape) if factors.roughness else 0
    weights = FrameWeights(
        factors.moving, factors.depth, factors.roughness, factors.mask, step, plain=PLAIN, min_depth=MIN_DEPTH
    )
    comparison = Comparison(ssim_window(torch.float32), SSIM_C1, SSIM_C2, factors.ssim, threads)
    return NativeFrameLosses.apply(*rendered, Supervision(maps, weights, comparison, MIN_WEIGHT))


def roughness_step(height: int, width: int) -> int:
    """Return the pixels between two that a bend of the depth compares."""
    return max(round(min(height, width) / ROUGHNESS_STEPS), 1)


def depth_loss(depth: Tensor, alpha: Tensor, prior: Tensor, confidence: Tensor) -> Tensor:
    """Confidence-weighted L1 between inverse depths, in units of the scene's median inverse depth (= 1).

    Our priors are in the cameras' own scale, so no per-image shift and scale is removed as the reference does.

    Args:
        depth: (H,W) composited `sum z a T`. alpha: (H,W). prior: (H,W) z depth, NaN = unknown. confidence: (H,W).
    """
    known = torch.isfinite(prior) & (prior > 0)
    weight = torch.where(known, confidence, torch.zeros_like(confidence))
    expected = torch.where(known, prior, torch.ones_like(prior)).reciprocal()
    # a/(sum z a T) is the inverse of the alpha-normalised depth; the floor keeps empty pixels finite.
    inverse = alpha / depth.clamp_min(MIN_DEPTH)
    return ((inverse - expected).abs() * weight).sum() / weight.sum().clamp_min(1.0)


def depth_roughness(depth: Tensor, alpha: Tensor, image: Tensor, unsure: Tensor) -> Tensor:
    """Return the mean bend of the inverse depth (1 = the scene's median) of plain pixels of unsure depth; 0 for planes.

    The inverse depth of a plane is linear in the picture. Colours do not tell where along their rays the Gaussians of a plain
    surface lie: without this they fray, which shows from the side alone.

    Args:
        depth: (H,W) composited `sum z a T`. alpha: (H,W). image: (H,W,3) in [0,1], the frame.
        unsure: (H,W) in [0,1], how little is known of the depth of a pixel of the background; 0 on moving objects, at whose
            outlines surfaces end.
    """
    inverse, step = alpha / depth.clamp_min(MIN_DEPTH), roughness_step(*image.shape[:2])
    grey, total = image.mean(-1), inverse.new_zeros(())
    for axis in (0, 1):
        texture = _second_difference(*_three(grey, axis, step)).abs()
        first, middle, last = _three(unsure, axis, step)
        weight = torch.exp(-texture / PLAIN) * torch.minimum(torch.minimum(first, middle), last)
        total = total + (_second_difference(*_three(inverse, axis, step)).abs() * weight).mean()
    return total


def _three(image: Tensor, axis: int, step: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the pixels, and those `step` before and behind them along `axis`, in the order in which they lie."""
    count = image.shape[axis] - 2 * step
    first, middle, last = (image.narrow(axis, k * step, count) for k in (0, 1, 2))
    return first, middle, last


def _second_difference(first: Tensor, middle: Tensor, last: Tensor) -> Tensor:
    return first - 2 * middle + last
