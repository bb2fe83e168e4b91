"""Carries a case's Gaussians by every form of the deformation in float32 and compares with one another in float64."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from benchmarks.studies.hard_cases import Check, within
from f4x_core.geometry import dual_quaternion, pose, quaternion
from f4x_core.native import open_library
from f4x_core.scaffold.deformation import (
    COLLAPSED,
    SIGN_BAND,
    deform,
    move_gaussians,
    node_poses_at,
    pairs_of,
    relative_motions,
)
from f4x_core.scaffold.deformation.native.autograd import GaussianTensors, NativeDeformer, NodeTensors
from f4x_core.scaffold.deformation.sparse import Deformer
from f4x_core.scaffold.skinning import SkinningWeights, skinning_weights

NODES, FRAMES, GAUSSIANS, SLOTS = 10, 5, 60, 4
LEAVES = ("local_xyz", "local_quat", "dw", "node_xyz", "node_quat", "radius")
Leaves = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Carried:
    """Nodes, and Gaussians that follow them; float64, each form takes what it needs."""

    leaves: Leaves
    """`local_xyz (N,3)`, `local_quat (N,4)` in the attach node's frame, `dw (N,K)`, `node_xyz (F,M,3)`, `node_quat (F,M,4)`,
    `radius (M,)`."""
    neighbours: np.ndarray  # (N, K), attach node first
    mask: np.ndarray  # (N, K)
    reference: np.ndarray  # (N,)
    times: np.ndarray  # (F,)

    def with_(self, **changes: np.ndarray) -> Carried:
        """The same with other leaves, neighbours, mask, reference or times."""
        leaves = self.leaves | {name: value for name, value in changes.items() if name in LEAVES}
        return replace(self, leaves=leaves, **{name: value for name, value in changes.items() if name not in LEAVES})


def turning(angle: float, spread: float = 0.15, frames: int = FRAMES, seed: int = 0) -> Carried:
    """Nodes that turn about nearly one axis, evenly to `angle` radians over the clip, and glide; `spread` is how unlike the
    turns of two nodes are, as a share of the whole."""
    rng = np.random.default_rng(seed)
    axis = quaternion.normalize(np.concatenate([np.zeros((1, 1)), rng.normal(size=(1, 3))], 1))[:, 1:]
    share = np.linspace(0, 1, frames)[:, None, None]
    turns = angle * (1 + spread * rng.uniform(-1, 1, (NODES, 1))) * axis
    start = quaternion.normalize(rng.normal(size=(NODES, 4)))
    node_quat = quaternion.multiply(quaternion.from_rotation_vector(share * turns), start)
    node_xyz = 0.5 * rng.normal(size=(NODES, 3)) + 0.2 * share * rng.normal(size=(NODES, 3))
    neighbours = np.stack([rng.permutation(NODES)[:SLOTS] for _ in range(GAUSSIANS)])
    leaves = {
        "local_xyz": 0.2 * rng.normal(size=(GAUSSIANS, 3)),
        "local_quat": rng.normal(size=(GAUSSIANS, 4)),
        "dw": np.zeros((GAUSSIANS, SLOTS)),
        "node_xyz": node_xyz,
        "node_quat": quaternion.align_sequence(node_quat),
        "radius": rng.uniform(0.3, 0.6, NODES),
    }
    mask = np.ones((GAUSSIANS, SLOTS), bool)
    return Carried(leaves, neighbours, mask, np.zeros(GAUSSIANS, int), np.arange(float(frames)))


def carry_plainly(carried: Carried, leaves: Leaves, time: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Every Gaussian by itself, as the formulas stand: the truth, in the dtype of the leaves."""
    neighbours, mask = torch.as_tensor(carried.neighbours), torch.as_tensor(carried.mask)
    reference = torch.as_tensor(carried.reference)[:, None]
    node_x = leaves["node_xyz"][reference, neighbours]  # (N,K,3)
    node_q = quaternion.normalize(leaves["node_quat"])[reference, neighbours]
    x = pose.transform(node_q[:, 0], node_x[:, 0], leaves["local_xyz"])
    q = quaternion.multiply(node_q[:, 0], quaternion.normalize(leaves["local_quat"]))
    weights, _ = skinning_weights(x, node_x, leaves["radius"][neighbours], mask, leaves["dw"])
    now_x, now_q = node_poses_at(carried.times, leaves["node_xyz"], leaves["node_quat"], time)
    motion = pose.compose(now_q[neighbours], now_x[neighbours], *pose.invert(node_q, node_x))
    relative = dual_quaternion.from_pose(*motion)  # (N,K,8)
    agree = (relative[..., :4] * relative[:, :1, :4]).sum(-1)
    signed = torch.where(agree < -SIGN_BAND, -weights, weights)
    turn, shift = dual_quaternion.to_pose(dual_quaternion.normalize((signed[..., None] * relative).sum(1), COLLAPSED))
    return quaternion.rotate(turn, x) + shift, quaternion.multiply(turn, q)


def _by_torch(carried: Carried, leaves: Leaves, time: float) -> tuple[torch.Tensor, torch.Tensor]:
    deformer = Deformer(carried.times, carried.reference, carried.neighbours, leaves["node_xyz"].shape[1])
    attach = carried.reference, carried.neighbours[:, 0]
    node_q = quaternion.normalize(leaves["node_quat"])[attach]
    x = pose.transform(node_q, leaves["node_xyz"][attach], leaves["local_xyz"])
    q = quaternion.multiply(node_q, quaternion.normalize(leaves["local_quat"]))
    mask = torch.as_tensor(carried.mask)
    weights, _ = deformer.skinning(x, leaves["node_xyz"], leaves["radius"], mask, leaves["dw"])
    turn, shift = deformer(leaves["node_xyz"], leaves["node_quat"], weights, None, time)
    return quaternion.rotate(turn, x) + shift, quaternion.multiply(turn, q)


def _by_library(carried: Carried, leaves: Leaves, time: float) -> tuple[torch.Tensor, torch.Tensor]:
    deformer = Deformer(carried.times, carried.reference, carried.neighbours, leaves["node_xyz"].shape[1])
    native = NativeDeformer(deformer, torch.as_tensor(carried.mask), "sigma", 1)
    gaussians, nodes = (tuple(leaves[name] for name in LEAVES[part]) for part in (slice(3), slice(3, None)))
    return native(GaussianTensors(*gaussians), NodeTensors(*nodes), (time,))[0]


def _played(carried: Carried, time: float, compiled: bool) -> tuple[np.ndarray, np.ndarray]:
    """What a player does with a scene file: weights and reference poses are stored, the rest is numpy or the library."""
    a = {name: value.astype(np.float32) for name, value in carried.leaves.items()}
    attach = carried.reference, carried.neighbours[:, 0]
    node_q = quaternion.normalize(a["node_quat"])[attach]
    x = pose.transform(node_q, a["node_xyz"][attach], a["local_xyz"])
    q = quaternion.multiply(node_q, quaternion.normalize(a["local_quat"]))
    node_x = a["node_xyz"][carried.reference[:, None], carried.neighbours]
    weights, _ = skinning_weights(x, node_x, a["radius"][carried.neighbours], carried.mask, a["dw"])
    strength, pairs = np.ones(len(x), np.float32), pairs_of(carried.neighbours, carried.reference)
    if compiled:
        table = relative_motions(carried.times, a["node_xyz"], a["node_quat"], pairs, time)
        return move_gaussians(table, pairs.index, weights, strength, x, q)
    moved = deform(carried.times, a["node_xyz"], a["node_quat"], pairs, SkinningWeights(weights, strength), time)
    rotation, means = pose.compose(*moved, q, x)
    return means, rotation


def differentiate(
    function: Callable[..., Any], carried: Carried, time: float, dtype: torch.dtype
) -> tuple[list[np.ndarray], dict[str, np.ndarray]]:
    """Places (N,3) and rotation matrices (N,3,3), and the gradients of a fixed random functional of them."""
    leaves = {k: torch.tensor(v, dtype=dtype, requires_grad=True) for k, v in carried.leaves.items()}
    means, quats = function(carried, leaves, time)
    values = [means, quaternion.to_matrix(quats)]
    generator = torch.Generator().manual_seed(1)
    seeds = [torch.randn(v.shape, generator=generator, dtype=torch.float32) for v in values]
    torch.autograd.backward(values, [seed.to(dtype) for seed in seeds])
    gradients = {k: np.zeros(v.shape) if v.grad is None else v.grad.numpy() for k, v in leaves.items()}
    return [value.detach().numpy() for value in values], gradients


def compare(
    carried: Carried,
    time: float | None = None,
    value: float = 5e-6,
    gradient: float = 5e-5,
    only: np.ndarray | slice = slice(None),
) -> Iterator[Check]:
    """Places, rotations and gradients of every form; `only` some Gaussians' values (gradients are always compared)."""
    time = float(carried.times[-1]) if time is None else time
    true, true_gradients = differentiate(carry_plainly, carried, time, torch.float64)
    expected = [part[only] for part in true]
    library = open_library()[0] is not None
    trained = {"torch": _by_torch} | ({"native": _by_library} if library else {})
    for name, function in trained.items():
        values, gradients = differentiate(function, carried, time, torch.float32)
        yield within("places and turns", _error([part[only] for part in values], expected), value, name)
        errors = {k: _relative(gradients[k], true_gradients[k]) for k in LEAVES}
        worst = max(errors, key=lambda k: errors[k])
        yield within(f"gradients, of {worst} the worst", errors[worst], gradient, name)
    for name, compiled in [("numpy", False), ("playback", True)][: 1 + library]:
        means, quats = _played(carried, time, compiled)
        played = [means[only], quaternion.to_matrix(quats)[only]]
        yield within("places and turns", _error(played, expected), value, name)


def _error(got: list[np.ndarray], expected: list[np.ndarray]) -> float:
    """Largest difference, places relative to their extent where that is above 1."""
    errors = [abs(a - b).max(initial=0) / max(1, abs(b).max(initial=0)) for a, b in zip(got, expected, strict=True)]
    return float(np.nan_to_num(max(errors), nan=np.inf))


def _relative(got: np.ndarray, expected: np.ndarray) -> float:
    """L2 error; gradients that are 0 in truth are measured against 1."""
    error = np.linalg.norm(got - expected) / max(np.linalg.norm(expected), 1)
    return float(np.nan_to_num(error, nan=np.inf))
