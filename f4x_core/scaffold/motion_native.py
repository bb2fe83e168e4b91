"""All losses of the scaffold's motion in one go by the compiled library, differentiable once. float32 on the CPU."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..native.motion import F4X_NODE_AXES, F4X_NODE_MOTION, MOTION
from .arap_native import Edges, Pairs, arap


class MotionWeights(NamedTuple):
    """Weights of the losses."""

    coordinate: float
    length: float
    velocity: float
    acceleration: float
    angular_velocity: float
    angular_acceleration: float


class MotionProblem(NamedTuple):
    """Everything that the losses of F frames depend on, beside the poses."""

    times: Tensor
    """(F,) float64, clip frames."""
    edges: Edges
    pairs: Pairs
    """Empty: the losses of coordinates and lengths are left out."""
    weights: MotionWeights
    threads: int


class NativeMotion(torch.autograd.Function):
    """Weighted sum of the losses of positions (F,M,3) and quaternions (F,M,4) of any length.

    Gradients are made on the way, as the result is a scalar.
    """

    @staticmethod
    def forward(ctx, xyz: Tensor, quat: Tensor, problem: MotionProblem) -> Tensor:
        """Return the sum, a scalar; raises F4xError where memory runs out."""
        times, edges, pairs, weights, threads = problem
        xyz, quat = xyz.contiguous(), quat.contiguous()
        arrays: dict[str, Tensor] = {"xyz": xyz, "quat": quat, "times": times}
        fixed: dict[str, Any] = {"frames": len(xyz), "nodes": xyz.shape[1], "threads": threads}
        names = ("velocity", "acceleration", "spin", "spin_change")
        fixed |= dict(zip(names, weights[2:], strict=True))
        loss, rigid = torch.empty(1, dtype=torch.float64), None
        d_xyz, d_quat = torch.empty_like(xyz), torch.empty_like(quat)
        of_motion = {"loss": loss, "d_xyz": d_xyz, "d_quat": d_quat}
        if pairs:
            axes = xyz.new_empty(*xyz.shape, 3)
            F4X_NODE_AXES(MOTION(**fixed, **arrays, axes=axes))
            rigid, gradients = arap(xyz, axes, edges, pairs, threads)
            of_motion["d_axes"] = gradients["d_axes"].mul_(weights.coordinate)
        if F4X_NODE_MOTION(MOTION(**fixed, **arrays, **of_motion)):
            raise F4xError(f"The scaffold ran out of memory at {len(xyz)} frames: fit fewer frames, by --frames.")
        if rigid is not None:
            loss += weights.coordinate * rigid[0] + weights.length * rigid[1]
            d_xyz.add_(gradients["d_coordinate"], alpha=weights.coordinate)
            d_xyz.add_(gradients["d_length"], alpha=weights.length)
        ctx.save_for_backward(d_xyz, d_quat)
        return loss[0].to(xyz.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Return the gradients of the positions and the quaternions."""
        return *(gradient * factor for gradient in ctx.saved_tensors), None
