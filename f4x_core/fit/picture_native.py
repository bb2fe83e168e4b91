"""The picture loss by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..native.binder import DOUBLE
from ..native.picture import F4X_PICTURE_LOSS, PICTURE


class Comparison(NamedTuple):
    """Constants of the comparison of two pictures."""

    window: Tensor
    """(11,) SSIM's blur."""
    c1: float
    c2: float
    """SSIM's two stabilisers."""
    structure: float
    """Weight of 1 - SSIM beside the L1."""
    threads: int


class NativePictureLoss(torch.autograd.Function):
    """Sum over pixels of `weight` (H,W) times the L1 over channels and `structure` (1 - SSIM) of two images (H,W,C).

    SSIM is its mean over channels. The gradient to the image is made on the way, because the result is a
    scalar; there is none to the target.
    """

    @staticmethod
    def forward(ctx, image: Tensor, target: Tensor, weight: Tensor, comparison: Comparison) -> Tensor:
        """Return the sum, a scalar; raises F4xError where memory runs out."""
        height, width, channels = image.shape
        stride = channels
        if not image.is_contiguous():
            if image.stride(2) == 1 and image.stride(0) == width * image.stride(1):
                stride = image.stride(1)  # the first channels of a wider picture
            else:
                image = image.contiguous()
        gradient = torch.empty(height, width, channels) if ctx.needs_input_grad[0] else None
        problem = PICTURE(
            width=width,
            height=height,
            channels=channels,
            stride=stride,
            image=image,
            target=target.contiguous(),
            weight=weight.contiguous(),
            factor=1.0,
            gradient_stride=channels,
            gradient=gradient,
            **comparison._asdict(),
        )
        total = DOUBLE()
        if F4X_PICTURE_LOSS(problem, total):
            raise F4xError(
                f"The picture loss ran out of memory at {width} x {height} pixels: fit at a smaller --width."
            )
        ctx.save_for_backward(gradient)
        return torch.full((), total.value, dtype=image.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Return the gradient of the image."""
        return ctx.saved_tensors[0] * factor, None, None, None
