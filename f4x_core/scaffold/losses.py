"""As-rigid-as-possible and smoothness losses of the scaffold. torch.

All losses are means over time and nodes, so their weights keep their meaning whatever the clip's length or the number
of nodes. Norms are plain L2; where a norm is 0 its gradient is taken as 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from ..geometry import quaternion
from ..native.kernels import TORCH, Kernels
from .distance import curve_distance
from .graph import EdgeLevel, GraphConfig, multilevel_edges
from .motion_native import MotionProblem, MotionWeights, NativeMotion
from .structure import Scaffold


@dataclass(frozen=True, eq=False)
class ArapEdges:
    """All edges of the graph and its coarse levels in one list."""

    node: torch.Tensor
    """(E,) int64."""
    neighbour: torch.Tensor
    """(E,) int64."""
    weight: torch.Tensor
    """(E,) level weight / number of the node's edges in that level / M: each level sums to a mean over nodes."""
    detached_from: int
    """Edges from here on (the coarse ones) send no gradient to the neighbour's position: the coarse set leads."""

    @property
    def listed(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, int]:
        """The fields, for the compiled library."""
        return self.node, self.neighbour, self.weight, self.detached_from

    @classmethod
    def of(cls, scaffold: Scaffold, graph: GraphConfig, seed: int = 0) -> "ArapEdges":
        """Return the edges of a scaffold and of coarse levels drawn anew, by distances over all its frames."""
        levels = multilevel_edges(curve_distance(scaffold.xyz, None, graph.kth), scaffold.unit, graph, seed)
        return cls.build(scaffold.neighbours, scaffold.edge_mask, graph.base_weight, levels)

    @classmethod
    def build(
        cls,
        neighbours: np.ndarray,
        edge_mask: np.ndarray,
        base_weight: float = 1.0,
        levels: list[EdgeLevel] | None = None,
        *,
        detach: bool = True,
        dtype: torch.dtype = torch.float32,
    ) -> "ArapEdges":
        """Return the edges of `neighbours (M, K)`, `edge_mask (M, K)` (self edges left out) and of coarse `levels`."""
        nodes = len(neighbours)
        node, slot = np.nonzero(edge_mask & (neighbours != np.arange(nodes)[:, None]))
        lists = [EdgeLevel(node, neighbours[node, slot], base_weight), *(levels or [])]
        weights = [level.weight / np.bincount(level.node, minlength=nodes)[level.node] / nodes for level in lists]
        return cls(
            torch.as_tensor(np.concatenate([level.node for level in lists])),
            torch.as_tensor(np.concatenate([level.neighbour for level in lists])),
            torch.as_tensor(np.concatenate(weights), dtype=dtype),
            len(lists[0].node) if detach else sum(len(level.node) for level in lists),
        )


class Smoothness(NamedTuple):
    """Scalars, in world units or radians per frame and per frame squared."""

    velocity: torch.Tensor
    acceleration: torch.Tensor
    angular_velocity: torch.Tensor
    angular_acceleration: torch.Tensor


@dataclass(frozen=True, eq=False)
class MotionTerms:
    """The losses of a scaffold's motion: between which nodes and frames, and how much each weighs."""

    edges: ArapEdges
    shifts: Mapping[int, float]
    """Frame distances and their weights."""
    weights: MotionWeights
    kernels: Kernels = TORCH
    """The compiled library computes the losses where these say so (float32 on the CPU)."""


def motion_loss(xyz: torch.Tensor, quat: torch.Tensor, times: torch.Tensor, terms: MotionTerms) -> torch.Tensor:
    """Return the weighted sum of `arap_losses` and `smoothness_losses`.

    `xyz (F, M, 3)`, `quat (F, M, 4)` of any length are the nodes' poses at `times (F,)`.
    """
    edges, shifts, weights, kernels = terms.edges, terms.shifts, terms.weights, terms.kernels
    if kernels.native:
        pairs = [pair for pair in shifts.items() if pair[0] < len(xyz)]
        problem = MotionProblem(times.double(), edges.listed, pairs, weights, kernels.threads)
        return NativeMotion.apply(xyz, quat, problem)
    unit = quaternion.normalize(quat)
    losses = *arap_losses(xyz, unit, edges, tuple(shifts), tuple(shifts.values())), *smoothness_losses(xyz, unit, times)
    return sum((w * loss for w, loss in zip(weights, losses, strict=True)), xyz.new_zeros(()))


def arap_losses(
    xyz: torch.Tensor,
    quat: torch.Tensor,
    edges: ArapEdges,
    shifts: tuple[int, ...] = (2, 4),
    shift_weights: tuple[float, ...] = (0.6, 0.4),
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return scalars `(coordinate, length)` of poses `xyz (F, M, 3)`, `quat (F, M, 4)` unit.

    With `l_ab(t) = R_b(t)^T (x_a(t) - x_b(t))`: `sum_s v_s mean_t,a sum_b h_ab |l_ab(t) - l_ab(t + s)|` and the same
    for `| |l_ab(t)| - |l_ab(t + s)| |`. Zero for every rigid motion of the whole. Shifts of F or more are left out.
    """
    pairs = [(shift, weight) for shift, weight in zip(shifts, shift_weights, strict=True) if shift < len(xyz)]
    origin = torch.cat(
        [
            xyz.index_select(1, edges.neighbour[: edges.detached_from]),
            xyz.detach().index_select(1, edges.neighbour[edges.detached_from :]),
        ],
        dim=1,
    )
    offset = xyz.index_select(1, edges.node) - origin  # (F, E, 3)
    frame = quaternion.to_matrix(quat).index_select(1, edges.neighbour)  # (F, E, 3, 3), columns are the axes
    local = (frame * offset[..., None]).sum(dim=-2)  # R^T offset
    coordinate = _Drift.apply(local, edges.weight, pairs)
    return coordinate, _Drift.apply(_norm(offset)[..., None], edges.weight, pairs)


def smoothness_losses(xyz: torch.Tensor, quat: torch.Tensor, times: torch.Tensor | None = None) -> Smoothness:
    """Return mean speeds and accelerations of `xyz (F, M, 3)` and `quat (F, M, 4)` unit at `times (F,)`.

    Without `times` frames are one apart: `|x_t+1 - x_t|`, `|x_t+1 - 2 x_t + x_t-1|`, `angle(R_t+1 R_t^T)` and the
    change of that angle. Unequal intervals give the derivatives of the same curves. Too few frames give 0.
    """
    zero = xyz.new_zeros(())
    if len(xyz) < 2:
        return Smoothness(zero, zero, zero, zero)
    interval = xyz.new_ones(len(xyz) - 1) if times is None else torch.diff(times).to(xyz)
    velocity = torch.diff(xyz, dim=0) / interval[:, None, None]
    turn = quaternion.multiply(quat[1:], quaternion.conjugate(quat[:-1]))
    spin = 2 * torch.atan2(_norm(turn[..., 1:]), turn[..., 0].abs()) / interval[:, None]  # (F-1, M) rad / frame
    if len(xyz) < 3:
        return Smoothness(_norm(velocity).mean(), zero, spin.mean(), zero)
    middle = (interval[1:] + interval[:-1]) / 2
    acceleration = _norm(torch.diff(velocity, dim=0)) / middle[:, None]
    spin_change = torch.diff(spin, dim=0).abs() / middle[:, None]
    return Smoothness(_norm(velocity).mean(), acceleration.mean(), spin.mean(), spin_change.mean())


def _norm(x: torch.Tensor) -> torch.Tensor:
    """Return the L2 norm over the last axis, with gradient 0 at 0."""
    squared = (x * x).sum(dim=-1)
    positive = squared > 0
    return torch.where(positive, torch.where(positive, squared, 1.0).sqrt(), 0.0)


class _Drift(torch.autograd.Function):
    """`sum_s v_s mean_t sum_e w_e |l_e(t) - l_e(t + s)|` of `l (F, E, C)`; its gradient is made on the way.

    The loss is a scalar, so the gradient is known up to a factor as soon as the differences are, and neither they nor
    their norms need to be kept or recomputed. No gradient to the edge weights.
    """

    @staticmethod
    def forward(ctx, local: torch.Tensor, weight: torch.Tensor, pairs: list[tuple[int, float]]) -> torch.Tensor:
        total = local.new_zeros(())
        gradient = torch.zeros_like(local)
        for shift, factor in pairs:
            scale = weight * (factor / (len(local) - shift))  # (E,)
            drift = local[shift:] - local[:-shift]
            norm = torch.linalg.vector_norm(drift, dim=-1)  # (F - shift, E)
            total += (norm @ scale).sum()
            drift *= torch.where(norm > 0, scale / norm, 0.0)[..., None]
            gradient[shift:] += drift
            gradient[:-shift] -= drift
        ctx.save_for_backward(gradient)
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, factor):
        return ctx.saved_tensors[0] * factor, None, None
