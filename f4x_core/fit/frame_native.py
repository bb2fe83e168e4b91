"""The losses of a frame's pixels in one go by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..native.binder import DOUBLE
from ..native.frame import F4X_FRAME_LOSSES, FRAME
from ..native.picture import F4X_PICTURE_LOSS, PICTURE
from .picture_native import Comparison


class FrameMaps(NamedTuple):
    """A frame and its priors, (H,W) or (H,W,3)."""

    frame: Tensor
    """uint8 colours."""
    prior: Tensor
    """float32 depth, NaN = unknown."""
    confidence: Tensor
    """float16 of the depth."""
    motion: Tensor
    """float16 score."""


class FrameWeights(NamedTuple):
    """Weights of the losses and their constants, named as in frame.cpp."""

    moving: float
    depth_factor: float
    bend_factor: float
    alpha_factor: float
    step: int
    plain: float
    min_depth: float


class Supervision(NamedTuple):
    """A frame with its priors, and how a render is compared with them."""

    maps: FrameMaps
    weights: FrameWeights
    comparison: Comparison
    min_attention: float
    """Lower bound of the sum of the pixels' weights that the picture loss is divided by."""


class NativeFrameLosses(torch.autograd.Function):
    """Weighted sum of the losses that compare channels (H,W,C), depth and alpha (H,W) with a frame and its priors.

    The gradients are made on the way, because the result is a scalar, and in the layout of what was rendered: autograd would
    write the whole picture anew for every channel that a loss looks at.
    """

    @staticmethod
    def forward(ctx, channels: Tensor, depth: Tensor, alpha: Tensor, supervision: Supervision) -> Tensor:
        """Return the sum, a scalar; raises F4xError where memory runs out."""
        maps, weights, comparison, min_attention = supervision
        height, width, count = channels.shape
        size = {"width": width, "height": height}
        gradients = [torch.empty_like(rendered) for rendered in (channels, depth, alpha)]
        target, attention = torch.empty(height, width, 3), torch.empty(height, width)
        of_pixels = torch.empty(2, dtype=torch.float64)
        problem = FRAME(
            **size,
            channels=count,
            threads=comparison.threads,
            image=channels,
            depth=depth,
            alpha=alpha,
            target=target,
            attention=attention,
            **dict(zip(("d_image", "d_depth", "d_alpha"), gradients, strict=True)),
            **maps._asdict(),
            **weights._asdict(),
        )
        failed = F4X_FRAME_LOSSES(problem, of_pixels)
        pixels, attended = of_pixels.tolist()
        factor, of_picture = 1 / max(attended, min_attention), DOUBLE()
        picture = PICTURE(
            **size,
            channels=3,
            stride=count,
            image=channels[..., :3],
            target=target,
            weight=attention,
            factor=factor,
            gradient_stride=count,
            gradient=gradients[0][..., :3],
            **comparison._asdict(),
        )
        if failed or F4X_PICTURE_LOSS(picture, of_picture):
            raise F4xError(f"The losses ran out of memory at {width} x {height} pixels: fit at a smaller --width.")
        ctx.save_for_backward(*gradients)
        return torch.full((), pixels + factor * of_picture.value, dtype=channels.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Return the gradients of channels, depth and alpha."""
        gradients = ctx.saved_tensors
        if factor != 1:  # seldom: of the total, that is what it is
            gradients = [gradient * factor for gradient in gradients]
        return *gradients, None
