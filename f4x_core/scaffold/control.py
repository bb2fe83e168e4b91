"""Nodes come and go during the fit. numpy; `rebase_local` also torch."""

from dataclasses import replace

import numpy as np

from ..errors import F4xError
from ..geometry import pose, quaternion
from ..geometry.arrays import Array
from .deformation import align_signs, interpolation_stencil, node_poses_at
from .distance import distance_to
from .graph import thin
from .structure import NodePoses, Scaffold


def densify_nodes(
    scaffold: Scaffold, xyz: np.ndarray, quat: np.ndarray, radius: float, next_id: int, reach: float = 5.0
) -> tuple[Scaffold, np.ndarray]:
    """Return (scaffold with new nodes at the end, `(C',)` the candidates that became nodes).

    Candidates are trajectories `xyz (F, C, 3)`, `quat (F, C, 4)` at the scaffold's times, for example of Gaussians
    that the nodes do not carry well, the most wanted first; they are thinned to `scaffold.unit`. New nodes get
    `radius` (world units) and ids from `next_id`. Rows of the graph that exist stay as they are, so nothing that is
    already carried moves; new rows point to the nearest old and new nodes, valid below `reach` units.
    """
    taken = thin(lambda i: distance_to(xyz[:, i : i + 1], xyz)[0], scaffold.unit, np.arange(xyz.shape[1]))
    if len(taken) == 0:
        return scaffold, taken
    old, slots = scaffold.neighbours.shape
    new = old + np.arange(len(taken))
    every_xyz = np.concatenate([scaffold.xyz, xyz[:, taken].astype(np.float32)], axis=1)
    distance = distance_to(every_xyz[:, new], every_xyz)  # (C', M')
    distance[np.arange(len(new)), new] = -1  # the node itself comes first
    order = np.argsort(distance, axis=1, kind="stable")[:, :slots]
    mask = np.take_along_axis(distance, order, axis=1) < reach * scaffold.unit
    padding = slots - order.shape[1]
    order = np.concatenate([order, np.repeat(new[:, None], padding, axis=1)], axis=1)
    mask = np.concatenate([mask, np.zeros((len(new), padding), bool)], axis=1)
    return (
        replace(
            scaffold,
            xyz=every_xyz,
            quat=np.concatenate([scaffold.quat, align_signs(quat[:, taken].astype(np.float32))], axis=1),
            radius=np.concatenate([scaffold.radius, np.full(len(new), radius, np.float32)]),
            certain=np.concatenate([scaffold.certain, np.zeros((len(scaffold.times), len(new)), bool)], axis=1),
            ids=np.concatenate([scaffold.ids, next_id + np.arange(len(new))]),
            neighbours=np.concatenate([scaffold.neighbours, order]),
            edge_mask=np.concatenate([scaffold.edge_mask, mask]),
        ),
        taken,
    )


def rebase_local(
    local_xyz: Array, local_quat: Array, reference: Array, old_attach: Array, new_attach: Array, nodes: NodePoses
) -> tuple[Array, Array]:
    """Return `(local_xyz (N, 3), local_quat (N, 4))` in the frames of `new_attach (N,)`; the world pose stays.

    `reference (N,)` are the Gaussians' reference frames, of the F of `nodes`.
    """
    old, new = (
        (quaternion.normalize(nodes.quat[reference, node]), nodes.xyz[reference, node])
        for node in (old_attach, new_attach)
    )
    q, t = pose.compose(*pose.invert(*new), *pose.compose(*old, local_quat, local_xyz))
    return t, q


def largest_weights(neighbours: np.ndarray, weights: np.ndarray, nodes: int) -> np.ndarray:
    """Return for each node `(M,)` its largest skinning weight over all Gaussians, `neighbours`, `weights (N, K)`."""
    greatest = np.zeros(nodes, weights.dtype)
    np.maximum.at(greatest, neighbours, weights)
    return greatest


def prune_nodes(
    scaffold: Scaffold, greatest_weight: np.ndarray, attach: np.ndarray, threshold: float = 0.02
) -> tuple[Scaffold, np.ndarray]:
    """Return (scaffold without useless nodes, `(M,)` new index of each node, -1 for removed ones).

    A node is useless when its `greatest_weight (M,)` is below `threshold` and no Gaussian is attached to it (`attach
    (N,)`). Slots that pointed to it become invalid and keep their place, so that per-slot corrections `dw` stay with
    their node: pictures change by at most the weight that was removed, not at all when that is 0.
    """
    if len(greatest_weight) != len(scaffold):
        raise F4xError(f"pruning needs one weight per node: {len(scaffold)}, got {len(greatest_weight)}")
    keep = greatest_weight >= threshold
    keep[attach] = True
    new_index = np.where(keep, np.cumsum(keep) - 1, -1)
    neighbours = new_index[scaffold.neighbours[keep]]
    gone = neighbours < 0
    own = np.arange(len(neighbours))[:, None]
    return (
        replace(
            scaffold,
            xyz=scaffold.xyz[:, keep],
            quat=scaffold.quat[:, keep],
            radius=scaffold.radius[keep],
            certain=scaffold.certain[:, keep],
            ids=scaffold.ids[keep],
            neighbours=np.where(gone, own, neighbours),
            edge_mask=scaffold.edge_mask[keep] & ~gone,
        ),
        new_index,
    )


def resample_in_time(scaffold: Scaffold, times: np.ndarray) -> Scaffold:
    """Return the scaffold at other `times`: the same curves, read between their knots.

    A position counts as certain where all knots that shape it are.
    """
    poses = [node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, time) for time in times]
    stencils = [interpolation_stencil(scaffold.times, time) for time in times]
    return replace(
        scaffold,
        times=np.asarray(times, np.float64),
        xyz=np.stack([xyz for xyz, _ in poses]),
        quat=align_signs(np.stack([quat for _, quat in poses])),
        certain=np.stack([scaffold.certain[indices[weights != 0]].all(axis=0) for indices, weights in stencils]),
    )
