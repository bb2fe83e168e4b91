"""Colours of spherical harmonics by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..native.appearance import APPEARANCE, F4X_APPEARANCE, F4X_APPEARANCE_BACKWARD
from ..native.binder import Function

# Coefficients per colour that the kernel knows: degree 0 to 3.
COEFFICIENTS = (1, 4, 9, 16)


class NativeAppearance(torch.autograd.Function):
    """`appearance(sh, means, quats, centre)` with `threads`; no gradient to the centre."""

    @staticmethod
    def forward(ctx, sh: Tensor, means: Tensor, quats: Tensor, centre: Tensor, threads: int) -> Tensor:
        """Colours (N,3)."""
        sh, means, quats = (tensor.contiguous() for tensor in (sh, means, quats))
        colors = torch.empty_like(means)
        ctx.save_for_backward(sh, means, quats, centre)
        ctx.threads = threads
        _call(F4X_APPEARANCE, centre, threads, sh=sh, means=means, quats=quats, colors=colors)
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx, sent: Tensor) -> Any:
        """Gradients of sh, means and quats."""
        sh, means, quats, centre = ctx.saved_tensors
        got = [torch.empty_like(tensor) for tensor in (sh, means, quats)]
        arrays = dict(zip(("d_sh", "d_means", "d_quats"), got, strict=True))
        sent = sent.contiguous()
        _call(F4X_APPEARANCE_BACKWARD, centre, ctx.threads, sh=sh, means=means, quats=quats, sent=sent, **arrays)
        return *got, None, None


def _call(function: Function, centre: Tensor, threads: int, **tensors: Tensor) -> None:
    count, coefficients, _ = tensors["sh"].shape
    function(
        APPEARANCE(count=count, coefficients=coefficients, threads=threads, centre=tuple(centre.tolist()), **tensors)
    )
