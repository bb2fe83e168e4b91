"""The native kernel as a torch function; imported only when tensors come in."""

from __future__ import annotations

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from ...errors import F4xError
from ..contract import RasterInput, RasterOutput
from . import library

NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmat", "K", "background", "mean2d_offset", "limit")


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, inputs, *tensors):
        arrays = {n: None if t is None else t.detach().numpy() for n, t in zip(NAMES, tensors, strict=True)}
        keep = any(ctx.needs_input_grad)
        loaded, _ = library.open_library()
        assert loaded is not None
        render = library.forward(loaded, inputs.with_arrays(arrays), keep)
        # The backward pass reads the same memory again: save the tensors so that torch notices in-place changes.
        ctx.save_for_backward(*(t for t in tensors if t is not None))
        ctx.library, ctx.render = loaded, render
        ctx.set_materialize_grads(False)
        out = render.output
        visible = torch.from_numpy(out.visible)
        ctx.mark_non_differentiable(visible)
        return torch.from_numpy(out.channels), torch.from_numpy(out.depth), torch.from_numpy(out.alpha), visible

    @staticmethod
    @once_differentiable
    def backward(ctx, channels, depth, alpha, visible):
        _ = ctx.saved_tensors
        sent = (None if g is None else g.numpy() for g in (channels, depth, alpha))
        got: dict[str, Any] = library.backward(ctx.library, ctx.render, *sent)
        if ctx.needs_input_grad[1 + NAMES.index("background")] and channels is not None:
            left = 1 - torch.from_numpy(ctx.render.output.alpha)  # (H, W)
            got["background"] = torch.einsum("hw,hwc->c", left, channels).numpy()
        needed = zip(NAMES, ctx.needs_input_grad[1:], strict=True)
        return None, *(torch.from_numpy(got[n]) if need and n in got else None for n, need in needed)


def rasterize_tensors(inputs: RasterInput) -> RasterOutput:
    """Return `rasterize` for float32 CPU tensors, differentiable once.

    Raises:
        F4xError: a tensor of another dtype or device.
    """
    arrays = inputs.arrays()
    for name, tensor in arrays.items():
        if tensor is not None and (tensor.dtype != torch.float32 or tensor.device.type != "cpu"):
            raise F4xError(
                f"The native raster backend takes float32 tensors on the CPU, but {name} is {tensor.dtype} on "
                f"{tensor.device}: use backend='torch'."
            )
    return RasterOutput(*_Rasterize.apply(inputs, *map(arrays.get, NAMES)))
