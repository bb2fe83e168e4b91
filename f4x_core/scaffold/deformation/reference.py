"""Deformation by dual-quaternion blending: nodes carry Gaussians through time. Needs numpy alone.

A Gaussian with reference time `times[r]` and neighbours `n_k` moves from there to `time` by the blend of the relative
motions `Q_nk(time) Q_nk(times[r])^-1`. One row of the dual-quaternion table belongs to one (node, reference) pair.
Unit dual quaternions `p` and `-p` are the same motion, so before blending the signs of a Gaussian's neighbours are
made equal to that of its first neighbour, the attach node (`slot_signs`).
"""

from dataclasses import dataclass

import numpy as np

from ...geometry import dual_quaternion, pose, quaternion
from ...geometry.arrays import Array, like, namespace
from ...geometry.interpolation import interpolate
from ..skinning import SkinningWeights

SIGN_BAND = 1e-3
"""Half width, as a quaternion dot product, of the band around "neighbours turned 180 degrees apart" (0.1 degree) in
which rounding would decide the sign; inside it the signs that were continued in time hold."""
COLLAPSED = 1e-4
"""A blend whose real part is shorter has cancelled out; the motion is then the identity."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """The (node, reference) pairs that Gaussians use, one row of the dual-quaternion table each."""

    node: np.ndarray
    """(P,) int64 node index."""
    reference: np.ndarray
    """(P,) int64 index into the scaffold's times; pairs are ordered by reference, then node."""
    index: np.ndarray
    """(N, K) int32 table row of every Gaussian's every slot, the attach node's first."""


def pairs_of(neighbours: np.ndarray, reference: np.ndarray) -> Pairs:
    """Return the pairs of Gaussians with node indices `neighbours (N, K)` and reference indices `reference (N,)`."""
    stride = int(neighbours.max(initial=0)) + 1
    keys = reference[:, None].astype(np.int64) * stride + neighbours
    present = np.zeros((int(reference.max(initial=0)) + 1) * stride, bool)
    present[keys] = True  # sorting the keys would take twenty times as long
    used = np.flatnonzero(present)
    return Pairs(used % stride, used // stride, np.cumsum(present, dtype=np.int32)[keys] - np.int32(1))


def interpolation_stencil(times: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return `(indices (4,) int64, coefficients (4,) float64)`: the value at `time` is `sum_j c_j value[i_j]`.

    The same curve as `geometry.interpolation`: cubic Hermite through the knots, coasting to rest outside. At a knot one
    coefficient is exactly 1 and the others 0; the coefficients always sum to 1. Clips shorter than 4 knots repeat
    their last index with coefficient 0.
    """
    count = len(times)
    dense = interpolate(times, np.eye(count), time)  # (F,): the curve is linear in its values
    knot = int(np.searchsorted(times, time, side="right")) - 1
    indices = np.clip(knot - 1, 0, max(count - 4, 0)) + np.arange(4)
    return np.minimum(indices, count - 1), np.where(indices < count, dense[np.minimum(indices, count - 1)], 0.0)


def node_poses_at(times: np.ndarray, xyz: Array, quat: Array, time: float) -> tuple[Array, Array]:
    """Return node poses `(xyz (M, 3), quat (M, 4)` unit `)` at any time; numpy or torch, differentiable.

    `xyz (F, M, 3)` and `quat (F, M, 4)` of any length at `times (F,)`. Exactly the stored poses at the stored times;
    rotations between are the normalised sum of the four nearest, on the hemisphere of the one that weighs most.
    """
    indices, coefficients = interpolation_stencil(times, time)
    used = np.flatnonzero(coefficients)
    indices, coefficients = indices[used], coefficients[used]
    knots = quaternion.normalize(quat[indices])  # (J, M, 4)
    if len(used) == 1:
        return xyz[indices[0]], knots[0]
    main = int(np.argmax(coefficients))
    xp = namespace(quat)
    ones = xp.ones_like(knots[..., :1])
    signs = xp.where((knots * knots[main]).sum(axis=-1, keepdims=True) < 0, -ones, ones)
    factor = like(coefficients[:, None, None].astype(xyz.dtype if xp is np else np.float64), xyz)
    return (factor * xyz[indices]).sum(axis=0), quaternion.normalize((factor * signs * knots).sum(axis=0))


def relative_motions(times: np.ndarray, xyz: Array, quat: Array, pairs: Pairs, time: float) -> Array:
    """Return the table `(P, 8)` of unit dual quaternions `Q_node(time) Q_node(times[reference])^-1`, numpy or torch."""
    return motions_to(node_poses_at(times, xyz, quat, time), xyz, quat, pairs)


def motions_to(now: tuple[Array, Array], xyz: Array, quat: Array, pairs: Pairs) -> Array:
    """Return the table `(P, 8)` of `Q_node Q_node(times[reference])^-1` to the node poses `now` = `(M, 3)`, unit `(M, 4)`."""
    x_now, q_now = now
    q_then = quaternion.normalize(quat[pairs.reference, pairs.node])
    inverse = pose.invert(q_then, xyz[pairs.reference, pairs.node])
    return dual_quaternion.from_pose(*pose.compose(q_now[pairs.node], x_now[pairs.node], *inverse))


def slot_signs(dq_table: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return `(N, K)` +1 or -1 that bring every slot's rotation to the hemisphere of slot 0, the attach node's."""
    real = dq_table[:, :4]
    dots = np.matmul(real[index], real[index[:, 0]][:, :, None])[..., 0]  # (N, K)
    return np.where(dots < -SIGN_BAND, -1, 1).astype(dq_table.dtype)


def blend(
    dq_table: np.ndarray, index: np.ndarray, weights: np.ndarray, strength: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rigid motion `(q (N, 4), t (N, 3))` of every Gaussian, in the dtype of the table.

    `dq_table (P, 8)` relative motions, `index (N, K)` its rows, `weights (N, K)`, `strength (N,)` blends with the
    identity (skipped when it is 1 everywhere). Signs are aligned here.
    """
    signed = weights * slot_signs(dq_table, index)
    summed = np.matmul(signed[:, None, :], dq_table[index])[:, 0]  # (N, 8)
    return dual_quaternion.to_pose(dual_quaternion.normalize(_faded(summed, strength), COLLAPSED))


def blend_reference(relative: Array, weights: Array, strength: Array) -> tuple[Array, Array]:
    """Return `(q (N, 4), t (N, 3))`, the plain form of `blend`: signs aligned to the heaviest neighbour.

    `relative (N, K, 8)` unit dual quaternions; numpy or torch, differentiable. Equal to `blend` wherever the attach
    node and the heaviest neighbour agree about every sign, that is unless rotations differ by about 180 degrees.
    """
    xp = namespace(relative)
    heaviest = xp.argmax(weights, axis=1)[:, None] == like(np.arange(weights.shape[1]), weights)  # (N, K) one-hot
    chosen = (relative[..., :4] * heaviest[..., None]).sum(axis=1, keepdims=True)  # (N, 1, 4)
    dots = (relative[..., :4] * chosen).sum(axis=-1)
    signed = xp.where(dots < 0, -weights, weights)
    summed = (signed[..., None] * relative).sum(axis=1)
    return dual_quaternion.to_pose(dual_quaternion.normalize(_faded(summed, strength), COLLAPSED))


def deform(
    times: np.ndarray, xyz: np.ndarray, quat: np.ndarray, pairs: Pairs, skinning: SkinningWeights, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion `(q (N, 4), t (N, 3))` from every Gaussian's reference time to `time`.

    Apply with `pose.compose(q, t, rotation, mean)`: `mean' = R mean + t`, `R' = R R_g`.
    """
    return blend(relative_motions(times, xyz, quat, pairs, time), pairs.index, *skinning)


def align_signs(
    quat: np.ndarray, neighbours: np.ndarray | None = None, edge_mask: np.ndarray | None = None, root: int = 0
) -> np.ndarray:
    """Return `quat (F, M, 4)` with the same rotations and consistent signs.

    In time every node stays on the hemisphere of the time before. With a graph (`neighbours (M, K)`, `edge_mask
    (M, K)`) nodes are also brought to the hemisphere of their parent in a breadth-first spanning tree at time `root`.
    """
    quat = quaternion.align_sequence(quat, axis=0)
    if neighbours is None:
        return quat
    nodes = len(neighbours)
    valid = np.ones_like(neighbours, bool) if edge_mask is None else edge_mask
    linked: list[list[int]] = [[] for _ in range(nodes)]
    for a, b in zip(*(ends.tolist() for ends in _edges(neighbours, valid)), strict=True):
        linked[a].append(b)
        linked[b].append(a)
    signs = np.zeros(nodes, quat.dtype)
    for start in range(nodes):
        if signs[start]:
            continue
        signs[start] = 1
        queue = [start]
        for parent in queue:
            for child in linked[parent]:
                if not signs[child]:
                    agree = quat[root, parent] @ quat[root, child] >= 0
                    signs[child] = signs[parent] if agree else -signs[parent]
                    queue.append(child)
    return quat * signs[None, :, None]


def _edges(neighbours: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the valid edges between different nodes."""
    node, slot = np.nonzero(valid)
    other = neighbours[node, slot]
    return node[node != other], other[node != other]


def _faded(summed: Array, strength: Array) -> Array:
    """Blend dual quaternions `(N, 8)` with the identity, on its hemisphere: `o P + (1 - o) 1, o D`."""
    if bool((strength == 1).all()):
        return summed
    xp = namespace(summed)
    identity = like(dual_quaternion.IDENTITY.astype(summed.dtype if xp is np else np.float64), summed)
    strength = strength[:, None]
    signed = xp.where(summed[:, :1] < 0, -summed, summed)
    return strength * signed + (1 - strength) * identity
