"""Activated Gaussians and their colours by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

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
        """Return the colours (N,3)."""
        sh, means, quats = (tensor.contiguous() for tensor in (sh, means, quats))
        colors = torch.empty_like(means)
        ctx.save_for_backward(sh, means, quats, centre)
        ctx.threads = threads
        _call(F4X_APPEARANCE, centre.tolist(), threads, {"colors": colors, "means": means, "quats": quats}, _split(sh))
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx, sent: Tensor) -> Any:
        """Return the gradients of sh, means and quats."""
        sh, means, quats, centre = ctx.saved_tensors
        d_sh, d_means, d_quats = (torch.empty_like(tensor) for tensor in (sh, means, quats))
        arrays = {"sent": sent.contiguous(), "means": means, "quats": quats, "d_means": d_means, "d_quats": d_quats}
        _call(F4X_APPEARANCE_BACKWARD, centre.tolist(), ctx.threads, arrays, _split(sh), _split(d_sh))
        return d_sh, d_means, d_quats, None, None


class DrawnSet(NamedTuple):
    """Parameters of one optimised set, at its places in the world; named as in `GaussianSet`."""

    means: Tensor
    """(N,3)"""
    quats: Tensor
    """(N,4) of any length."""
    log_scales: Tensor
    opacity_logits: Tensor
    sh0: Tensor
    sh_more: Tensor
    """`shN` of the set."""
    log_lifetimes: Tensor | None = None
    """(N,2); None where the Gaussians are there at all times."""
    there: Tensor | None = None
    """(N,3) positions that are drawn as channels 4 to 6; None for `means`, which then get no gradient from these."""


class Drawn(NamedTuple):
    """Arrays of N Gaussians for the raster."""

    means: Tensor
    """(N,3)"""
    quats: Tensor
    """(N,4)"""
    scales: Tensor
    """(N,3)"""
    opacities: Tensor
    """(N,)"""
    colors: Tensor
    """(N,C)"""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Arguments of `NativeDrawing` that have no gradient."""

    centre: tuple[float, float, float]
    """Centre of the camera."""
    channels: int
    """3 colours; 4 with the mark of what is dynamic; 7 with positions."""
    time: float
    """Time that is drawn, in clip frames."""
    born: Tensor | None
    """(N,) clip time at which each Gaussian of the set with lifetimes has its reference."""
    whole: float
    """Fraction of a lifetime in which a Gaussian is there wholly."""
    margin: float
    """Opacities are kept this far from 1 before they fade."""
    frozen: tuple[Drawn, Tensor] | None
    """Gaussians that never change, without their colours, and their harmonics (N,S,3)."""
    threads: int

    def problem_of(self, own: DrawnSet) -> dict[str, Any]:
        """Return the fields of `APPEARANCE` that both passes read."""
        dynamic = own.log_lifetimes is not None
        fixed = {"mark": float(dynamic), "time": self.time, "whole": self.whole, "margin": self.margin}
        arrays = {"means": own.means, "quats": own.quats, "log_scales": own.log_scales, "logits": own.opacity_logits}
        return fixed | arrays | {"log_lifetimes": own.log_lifetimes, "born": self.born if dynamic else None}


class NativeDrawing(torch.autograd.Function):
    """`SceneModel.drawn`: optimised sets one after the other, then the frozen Gaussians, as the raster takes them.

    Arguments: a `Drawing`, then the tensors of every `DrawnSet`. In one go, because a dozen operators of torch on each set's
    arrays, and then on all, are a tenth of a step that no second thread shortens.
    """

    @staticmethod
    def forward(ctx, drawing: Drawing, *tensors: Tensor | None) -> Any:
        """Return the tensors of a `Drawn`."""
        sets = _sets_of(tensors)
        frozen = drawing.frozen
        lengths = [len(own.means) for own in sets] + ([] if frozen is None else [len(frozen[0].means)])
        drawn = Drawn(*(torch.empty(sum(lengths), *width) for width in ((3,), (4,), (3,), (), (drawing.channels,))))
        for own, rows in zip(sets, _slices(lengths), strict=False):
            part = Drawn(*(tensor[rows] for tensor in drawn))
            there = (own.means if own.there is None else own.there) if drawing.channels > 4 else None
            written: dict[str, Tensor | None] = {
                "drawn_means": part.means,
                "drawn_quats": part.quats,
                "scales": part.scales,
            }
            written |= {"opacities": part.opacities, "colors": part.colors, "there": there}
            coefficients = own.sh0[:, 0], own.sh_more
            _call(F4X_APPEARANCE, drawing.centre, drawing.threads, drawing.problem_of(own) | written, coefficients)
        if frozen is not None:
            fixed, sh = frozen
            part = Drawn(*(tensor[-len(sh) :] for tensor in drawn))
            for to, known in zip(part[:-1], fixed[:-1], strict=True):
                to.copy_(known)
            arrays: dict[str, Tensor | None] = {"means": fixed.means, "quats": fixed.quats, "colors": part.colors}
            arrays |= {"there": fixed.means if drawing.channels > 4 else None}
            _call(F4X_APPEARANCE, drawing.centre, drawing.threads, arrays, _split(sh))
        ctx.save_for_backward(*tensors)
        ctx.drawing, ctx.lengths = drawing, lengths
        return tuple(drawn)

    @staticmethod
    @once_differentiable
    def backward(ctx, *sent: Tensor) -> Any:
        """Return the gradients of the tensors of every set."""
        sets, drawing = _sets_of(ctx.saved_tensors), ctx.drawing
        sent = Drawn(*(gradient.contiguous() for gradient in sent))
        got: list[Tensor | None] = []
        wanted = _sets_of(ctx.needs_input_grad[1:])
        for own, rows, needed in zip(sets, _slices(ctx.lengths), wanted, strict=False):
            if not any(needed):
                got += [None] * len(own)
                continue
            part = Drawn(*(gradient[rows] for gradient in sent))
            found = DrawnSet(*(None if tensor is None else torch.empty_like(tensor) for tensor in own))  # type: ignore[arg-type]
            arrays = {"sent_" + name: gradient for name, gradient in part._asdict().items() if name != "colors"}
            arrays |= {"sent": part.colors, "d_means": found.means, "d_quats": found.quats, "d_there": found.there}
            arrays |= {"d_log_scales": found.log_scales, "d_logits": found.opacity_logits}
            arrays |= {"d_log_lifetimes": found.log_lifetimes}
            coefficients, gradients = ((each.sh0[:, 0], each.sh_more) for each in (own, found))
            fields = drawing.problem_of(own) | arrays
            _call(F4X_APPEARANCE_BACKWARD, drawing.centre, drawing.threads, fields, coefficients, gradients)
            got += found
        return None, *got


def _sets_of(tensors: Sequence[Tensor | None]) -> list[DrawnSet]:
    width = len(DrawnSet._fields)
    return [DrawnSet(*tensors[first : first + width]) for first in range(0, len(tensors), width)]  # type: ignore[arg-type]


def _slices(lengths: Sequence[int]) -> list[slice]:
    """Return the rows of each part of so many rows."""
    return [slice(end - length, end) for end, length in zip(accumulate(lengths), lengths, strict=True)]


def _split(sh: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first coefficients (N,3) of harmonics (N,S,3), and the others (N,S-1,3)."""
    return sh[:, 0], sh[:, 1:]


def _call(
    function: Function,
    centre: Sequence[float],
    threads: int,
    fields: Mapping[str, Any],
    coefficients: tuple[Tensor, Tensor],
    gradients: tuple[Tensor, Tensor] | None = None,
) -> None:
    """Call the kernel for Gaussians with these harmonics, their first coefficient and the others, and gradients of them."""
    first, more = coefficients
    count, further, _ = more.shape
    arrays = {"first": first, "more": more if further else None}
    if gradients is not None:
        arrays |= {"d_first": gradients[0], "d_more": gradients[1] if further else None}
    colors = fields["colors"] if "colors" in fields else fields["sent"]
    plain = {"mark": 0.0, "time": 0.0, "whole": 0.0, "margin": 0.0}
    function(
        APPEARANCE(
            count=count,
            coefficients=1 + further,
            more_coefficients=further,
            threads=threads,
            channels=colors.shape[1],
            first_stride=first.stride(0),
            more_stride=more.stride(0),
            centre=tuple(centre),
            **plain | dict(fields) | arrays,
        )
    )
