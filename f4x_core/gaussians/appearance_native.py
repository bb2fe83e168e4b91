"""Colours of spherical harmonics by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..native.binder import FLOAT, INT32, INT64, Array, Function, Struct

# Coefficients per colour that the kernel knows: degree 0 to 3.
COEFFICIENTS = (1, 4, 9, 16)
_SH, _XYZ, _QUAT = ("count", "coefficients", 3), ("count", 3), ("count", 4)
APPEARANCE = Struct(
    "Appearance",
    {
        "count": INT64,
        "coefficients": INT32,
        "threads": INT32,
        "centre": FLOAT * 3,
        "sh": Array("float32", _SH),
        "means": Array("float32", _XYZ),
        "quats": Array("float32", _QUAT),
        "colors": Array("float32", _XYZ, optional=True, output=True),
        "sent": Array("float32", _XYZ, optional=True),
        "d_sh": Array("float32", _SH, optional=True, output=True),
        "d_means": Array("float32", _XYZ, optional=True, output=True),
        "d_quats": Array("float32", _QUAT, optional=True, output=True),
    },
)
"""`struct Appearance` of appearance.cpp; what only one of the two passes reads or writes is optional."""
F4X_APPEARANCE = Function("f4x_appearance", {"problem": APPEARANCE})
F4X_APPEARANCE_BACKWARD = Function("f4x_appearance_backward", {"problem": APPEARANCE})


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
