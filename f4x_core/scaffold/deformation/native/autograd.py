"""The deformation of `sparse` by the compiled library: from local poses to moved ones in one step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ....geometry import quaternion
from ....geometry.arrays import safe_norm
from ...skinning import Kernel
from ...structure import NodePoses
from ..reference import node_poses_at
from ..sparse import Deformer
from . import library

NAMES = ("xyz", "quat", "dw", "node_xyz", "node_quat", "radius", "now_xyz", "now_quat")
"""Names in `library` of the tensors of `GaussianTensors`, `NodeTensors` and `NodePoses`, in this order."""


class GaussianTensors(NamedTuple):
    """Parameters of N Gaussians in the frames of their nodes."""

    xyz: Tensor
    """(N, 3)"""
    quat: Tensor
    """(N, 4) of any length."""
    dw: Tensor | None
    """(N, K) learnt corrections of the skinning weights."""


class NodeTensors(NamedTuple):
    """Parameters of M nodes."""

    xyz: Tensor
    """(F, M, 3)"""
    quat: Tensor
    """(F, M, 4) of any length."""
    radius: Tensor
    """(M,)"""


@dataclass(frozen=True, eq=False)
class SkinningData:
    """Constants of skinning during optimisation: nodes of each Gaussian, and the kernel."""

    arrays: Mapping[str, np.ndarray]
    """`index (N, K)` int32, `mask (N, K)` bool, `node (P,)` and `then (P,)` int64 of `library`."""
    kernel: Kernel
    threads: int

    @classmethod
    def of(cls, deformer: Deformer, mask: Tensor, kernel: Kernel, threads: int) -> SkinningData:
        """Return the same as in `deformer`; `mask (N, K)` bool are its valid neighbours."""
        fixed = {"node": deformer.node.numpy(), "then": deformer.then.numpy(), "mask": mask.numpy()}
        return cls(fixed | {"index": deformer.pairs.index}, kernel, threads)

    def taken(self, rows: np.ndarray) -> SkinningData:
        """Return those of the Gaussians `rows (M,)`."""
        chosen = {name: self.arrays[name][rows] for name in ("index", "mask")}
        return replace(self, arrays={**self.arrays, **chosen})

    def deform_at(
        self, knots: Sequence[int], gaussians: GaussianTensors, nodes: NodeTensors
    ) -> list[tuple[Tensor, Tensor]]:
        """Return `deform` at the times that the nodes' poses are stored for, by their indices `knots` in F.

        The poses are looked up here: one node of autograd in place of dozens.
        """
        moved = _Deformation.apply(self, tuple(knots), *gaussians, *nodes, None, None)
        return list(zip(moved[: len(knots)], moved[len(knots) :], strict=True))

    def deform(self, gaussians: GaussianTensors, nodes: NodeTensors, now: NodePoses) -> list[tuple[Tensor, Tensor]]:
        """Return `(means (N, 3), quats (N, 4))` at each of T times, differentiable once; float32 on the CPU.

        `now` are the nodes' poses at the T times. Strength is 1. The gradient of `now.quat` is right only across the
        quaternions, so they must come from a normalisation. Gradients are bit-equal for every number of threads.
        """
        times = len(now.xyz)
        moved = _Deformation.apply(self, None, *gaussians, *nodes, *now)
        return list(zip(moved[:times], moved[times:], strict=True))


class _Deformation(torch.autograd.Function):
    @staticmethod
    def forward(ctx, skinning: SkinningData, knots: tuple[int, ...] | None, *tensors: Tensor | None) -> Any:
        arrays = _arrays(skinning, knots, tensors)
        tables = library.relate(arrays, skinning.threads)
        means, quats = library.forward(
            arrays | {"nodes": tables[0], "motions": tables[1:]}, skinning.kernel, skinning.threads
        )
        ctx.skinning, ctx.knots, ctx.tables = skinning, knots, tables
        ctx.save_for_backward(*tensors)
        return *map(torch.from_numpy, means), *map(torch.from_numpy, quats)

    @staticmethod
    @once_differentiable
    def backward(ctx, *sent: Tensor) -> Any:
        skinning, knots, tables, times = ctx.skinning, ctx.knots, ctx.tables, len(sent) // 2
        means, quats = (_stacked(part) for part in (sent[:times], sent[times:]))
        arrays = _arrays(skinning, knots, ctx.saved_tensors) | {"nodes": tables[0], "motions": tables[1:]}
        got = library.backward(arrays, skinning.kernel, skinning.threads, means, quats)
        got |= library.relate_backward(arrays, got["tables"], skinning.threads)
        if knots is not None:
            _add_to_knots(got, arrays, knots)
        needed = zip(NAMES, ctx.needs_input_grad[2:], strict=True)
        return None, None, *(torch.from_numpy(got[name]) if need else None for name, need in needed)


def _stacked(parts: Sequence[Tensor]) -> np.ndarray:
    """Return the tensors of one shape behind each other; of one, itself."""
    return parts[0].numpy()[None] if len(parts) == 1 else torch.stack(tuple(parts)).numpy()


def _add_to_knots(got: dict[str, np.ndarray], arrays: Mapping[str, Any], knots: Sequence[int]) -> None:
    """Carry the gradients of the poses at `knots` on to the stored ones."""
    for k, knot in enumerate(knots):
        got["node_xyz"][knot] += got["now_xyz"][k]
        unit, sent = arrays["now_quat"][k], got["now_quat"][k]
        length, valid = safe_norm(arrays["node_quat"][knot])
        across = (sent - unit * (unit * sent).sum(1, keepdims=True)) / length
        got["node_quat"][knot] += np.where(valid, across, 0)


def _arrays(skinning: SkinningData, knots: tuple[int, ...] | None, tensors: Sequence[Tensor | None]) -> dict[str, Any]:
    named = zip(NAMES, tensors, strict=True)
    arrays: dict[str, Any] = {
        **skinning.arrays,
        **{n: None if tensor is None else tensor.detach().numpy() for n, tensor in named},
    }
    if knots is not None:
        arrays["now_xyz"] = arrays["node_xyz"][list(knots)]
        arrays["now_quat"] = quaternion.normalize(arrays["node_quat"][list(knots)])
    return arrays


class NativeDeformer:
    """Moves Gaussians with the scaffold like `Deformer`, skinning included; strength is 1."""

    def __init__(self, deformer: Deformer, mask: Tensor, kernel: Kernel, threads: int):
        """Prepare the Gaussians of `deformer` for the kernel; `mask (N, K)` bool: their valid neighbours."""
        self.skinning = SkinningData.of(deformer, mask, kernel, threads)
        self.times = deformer.times
        self._knots = {float(time): place for place, time in enumerate(self.times)}

    def __call__(
        self, gaussians: GaussianTensors, nodes: NodeTensors, times: Sequence[float], rows: Tensor | None = None
    ) -> list[tuple[Tensor, Tensor]]:
        """Return `(means (M, 3), quats (M, 4))` at each of `times`, differentiable once.

        The M `gaussians` are the `rows` (M,) of those of the deformer, or all.
        """
        skinning = self.skinning if rows is None else self.skinning.taken(rows.numpy())
        if all(time in self._knots for time in times):
            return skinning.deform_at([self._knots[time] for time in times], gaussians, nodes)
        poses = [node_poses_at(self.times, nodes.xyz, nodes.quat, time) for time in times]
        now = NodePoses(*(torch.stack(part) for part in zip(*poses, strict=True)))
        return skinning.deform(gaussians, nodes, now)
