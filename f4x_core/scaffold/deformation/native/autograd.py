"""The deformation of `sparse` by the compiled library: from local poses to moved ones in one step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...skinning import Kernel
from ..reference import node_poses_at
from ..sparse import Deformer
from . import library

NAMES = ("xyz", "quat", "dw", "node_xyz", "node_quat", "radius", "now_xyz", "now_quat")


@dataclass(frozen=True, eq=False)
class SkinningData:
    """Constants of skinning during optimisation: nodes of each Gaussian, and the kernel."""

    arrays: Mapping[str, np.ndarray]
    """`index (N, K)` int32, `mask (N, K)` bool, `node (P,)` and `then (P,)` int64 of `library`."""
    kernel: Kernel
    threads: int

    @classmethod
    def of(cls, deformer: Deformer, mask: Tensor, kernel: Kernel, threads: int) -> SkinningData:
        """The same as in `deformer`; `mask (N, K)` bool are its valid neighbours."""
        fixed = {"node": deformer.node.numpy(), "then": deformer.then.numpy(), "mask": mask.numpy()}
        return cls(fixed | {"index": deformer.pairs.index}, kernel, threads)

    def deform(
        self,
        xyz: Tensor,
        quat: Tensor,
        dw: Tensor | None,
        node_xyz: Tensor,
        node_quat: Tensor,
        radius: Tensor,
        now_xyz: Tensor,
        now_quat: Tensor,
    ) -> list[tuple[Tensor, Tensor]]:
        """Return `(means (N, 3), quats (N, 4))` at each of T times, differentiable once; float32 on the CPU.

        `xyz (N, 3)`, `quat (N, 4)` of any length and `dw (N, K)` or None are the Gaussians' parameters; `node_xyz (F, M, 3)`,
        `node_quat (F, M, 4)` of any length and `radius (M,)` those of the nodes; `now_xyz (T, M, 3)`, `now_quat (T, M, 4)`
        their poses at the T times. Strength is 1. The gradient of `now_quat` is right only across the quaternions, so they
        must come from a normalisation. Gradients are bit-equal for every number of threads.
        """
        times = len(now_xyz)
        moved = _Deformation.apply(self, xyz, quat, dw, node_xyz, node_quat, radius, now_xyz, now_quat)
        return list(zip(moved[:times], moved[times:], strict=True))


class _Deformation(torch.autograd.Function):
    @staticmethod
    def forward(ctx, skinning: SkinningData, *tensors: Tensor | None) -> Any:
        arrays = _arrays(skinning, tensors)
        tables = library.relate(arrays)
        means, quats = library.forward(
            arrays | {"nodes": tables[0], "motions": tables[1:]}, skinning.kernel, skinning.threads
        )
        ctx.skinning, ctx.tables = skinning, tables
        ctx.save_for_backward(*tensors)
        return *map(torch.from_numpy, means), *map(torch.from_numpy, quats)

    @staticmethod
    @once_differentiable
    def backward(ctx, *sent: Tensor) -> Any:
        skinning, tables, times = ctx.skinning, ctx.tables, len(sent) // 2
        means, quats = (torch.stack(part).numpy() for part in (sent[:times], sent[times:]))
        arrays = _arrays(skinning, ctx.saved_tensors) | {"nodes": tables[0], "motions": tables[1:]}
        got = library.backward(arrays, skinning.kernel, skinning.threads, means, quats)
        got |= library.relate_backward(arrays, got["tables"])
        needed = zip(NAMES, ctx.needs_input_grad[1:], strict=True)
        return None, *(torch.from_numpy(got[name]) if need else None for name, need in needed)


def _arrays(skinning: SkinningData, tensors: Sequence[Tensor | None]) -> dict[str, Any]:
    named = zip(NAMES, tensors, strict=True)
    return {**skinning.arrays, **{name: None if tensor is None else tensor.detach().numpy() for name, tensor in named}}


class NativeDeformer:
    """Moves Gaussians with the scaffold like `Deformer`, skinning included; strength is 1."""

    def __init__(self, deformer: Deformer, mask: Tensor, kernel: Kernel, threads: int):
        """`mask (N, K)` bool are the valid neighbours of the Gaussians of `deformer`."""
        self.skinning = SkinningData.of(deformer, mask, kernel, threads)
        self.times = deformer.times

    def __call__(
        self,
        xyz: Tensor,
        quat: Tensor,
        dw: Tensor | None,
        node_xyz: Tensor,
        node_quat: Tensor,
        radius: Tensor,
        times: Sequence[float],
    ) -> list[tuple[Tensor, Tensor]]:
        """Return `(means (N, 3), quats (N, 4))` at each of `times`; the tensors are those of `SkinningData.deform`."""
        poses = [node_poses_at(self.times, node_xyz, node_quat, time) for time in times]
        now_xyz, now_quat = (torch.stack(part) for part in zip(*poses, strict=True))
        return self.skinning.deform(xyz, quat, dw, node_xyz, node_quat, radius, now_xyz, now_quat)
