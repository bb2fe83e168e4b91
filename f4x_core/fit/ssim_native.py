"""The structural part of the picture loss by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..native.binder import DOUBLE, FLOAT, INT32, INT64, Array, Function, Result, Struct

PICTURE = ("height", "width", "channels")
SSIM = Struct(
    "Ssim",
    {
        **dict.fromkeys(("width", "height", "channels", "threads"), INT32),
        "stride": INT64,
        "image": Array("float32", PICTURE, strides=("width*stride", "stride", 1)),
        "target": Array("float32", PICTURE),
        "weight": Array("float32", ("height", "width")),
        "window": Array("float32", (11,)),
        "c1": FLOAT,
        "c2": FLOAT,
        "gradient": Array("float32", PICTURE, optional=True, output=True),
    },
)
"""`struct Ssim` of ssim.cpp."""
F4X_DSSIM = Function("f4x_dssim", {"problem": SSIM, "total": Result(DOUBLE)}, INT32)


class NativeDissimilarity(torch.autograd.Function):
    """Sum over pixels of `weight` (H,W) times 1 - SSIM (mean over channels) of two images (H,W,C).

    `window` (11,) is the blur, `constants` SSIM's two stabilisers. The gradient to the image is made on the way, because the
    result is a scalar; there is none to the target.
    """

    @staticmethod
    def forward(
        ctx,
        image: Tensor,
        target: Tensor,
        weight: Tensor,
        window: Tensor,
        constants: tuple[float, float],
        threads: int,
    ) -> Tensor:
        """The sum, a scalar; raises F4xError where memory runs out."""
        height, width, channels = image.shape
        stride = channels
        if not image.is_contiguous():
            if image.stride(2) == 1 and image.stride(0) == width * image.stride(1):
                stride = image.stride(1)  # the first channels of a wider picture
            else:
                image = image.contiguous()
        target, weight, window = target.contiguous(), weight.contiguous(), window.contiguous()
        gradient = torch.empty(height, width, channels) if ctx.needs_input_grad[0] else None
        problem = SSIM(
            width=width,
            height=height,
            channels=channels,
            threads=threads,
            stride=stride,
            image=image,
            target=target,
            weight=weight,
            window=window,
            c1=constants[0],
            c2=constants[1],
            gradient=gradient,
        )
        total = DOUBLE()
        if F4X_DSSIM(problem, total):
            raise F4xError(
                f"The picture loss ran out of memory at {width} x {height} pixels: fit at a smaller --width."
            )
        ctx.save_for_backward(gradient)
        return torch.full((), total.value, dtype=image.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Gradient of the image."""
        return ctx.saved_tensors[0] * factor, None, None, None, None, None
