"""Colours of spherical harmonics by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..native import require_library

# Coefficients per colour that the kernel knows: degree 0 to 3.
COEFFICIENTS = (1, 4, 9, 16)
_POINTERS = ("sh", "means", "quats", "colors", "sent", "d_sh", "d_means", "d_quats")


class _Appearance(ctypes.Structure):
    """`struct Appearance` of appearance.cpp."""

    _fields_ = [
        ("count", ctypes.c_int64),
        ("coefficients", ctypes.c_int32),
        ("threads", ctypes.c_int32),
        ("centre", ctypes.c_float * 3),
        *((name, ctypes.c_void_p) for name in _POINTERS),
    ]


class NativeAppearance(torch.autograd.Function):
    """`appearance(sh, means, quats, centre)` with `threads`; no gradient to the centre."""

    @staticmethod
    def forward(ctx, sh: Tensor, means: Tensor, quats: Tensor, centre: Tensor, threads: int) -> Tensor:
        """Colours (N,3)."""
        sh, means, quats = (tensor.detach().contiguous() for tensor in (sh, means, quats))
        colors = torch.empty_like(means)
        ctx.save_for_backward(sh, means, quats, centre)
        ctx.threads = threads
        _call("f4x_appearance", centre, threads, sh=sh, means=means, quats=quats, colors=colors)
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx, sent: Tensor) -> Any:
        """Gradients of sh, means and quats."""
        sh, means, quats, centre = ctx.saved_tensors
        got = [torch.empty_like(tensor) for tensor in (sh, means, quats)]
        arrays = dict(zip(("d_sh", "d_means", "d_quats"), got, strict=True))
        sent = sent.contiguous()
        _call("f4x_appearance_backward", centre, ctx.threads, sh=sh, means=means, quats=quats, sent=sent, **arrays)
        return *got, None, None


def _call(name: str, centre: Tensor, threads: int, **tensors: Tensor) -> None:
    sh = tensors["sh"]
    problem = _Appearance(
        count=len(sh),
        coefficients=sh.shape[1],
        threads=threads,
        centre=tuple(centre.tolist()),
        **{key: tensor.data_ptr() for key, tensor in tensors.items()},
    )
    getattr(require_library(), name)(ctypes.byref(problem))
