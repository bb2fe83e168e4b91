"""The structural part of the picture loss by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..native import require_library

_POINTERS = ("image", "target", "weight", "window")


class _Similarity(ctypes.Structure):
    """`struct Similarity` of similarity.cpp."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("width", "height", "channels", "threads")),
        ("stride", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in _POINTERS),
        ("c1", ctypes.c_float),
        ("c2", ctypes.c_float),
        ("gradient", ctypes.c_void_p),
    ]


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
        image = image.detach()
        if image.stride(2) != 1 or image.stride(0) != width * image.stride(1):
            image = image.contiguous()
        target, weight, window = target.contiguous(), weight.contiguous(), window.contiguous()
        gradient = torch.empty(height, width, channels) if ctx.needs_input_grad[0] else None
        problem = _Similarity(
            width=width,
            height=height,
            channels=channels,
            threads=threads,
            stride=image.stride(1),
            image=image.data_ptr(),
            target=target.data_ptr(),
            weight=weight.data_ptr(),
            window=window.data_ptr(),
            c1=constants[0],
            c2=constants[1],
            gradient=None if gradient is None else gradient.data_ptr(),
        )
        total = ctypes.c_double()
        if require_library().f4x_dissimilarity(ctypes.byref(problem), ctypes.byref(total)):
            raise F4xError(
                f"The picture loss ran out of memory at {width} x {height} pixels: fit at a smaller --width."
            )
        ctx.save_for_backward(gradient)
        return image.new_tensor(total.value)

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Gradient of the image."""
        return ctx.saved_tensors[0] * factor, None, None, None, None, None
