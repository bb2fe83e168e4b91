"""Scaffolds of overlapping windows of one clip become one: nodes that move alike over the overlap are the same node. numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..geometry import pose, quaternion
from ..geometry.interpolation import presence
from ..scaffold.deformation import align_signs
from ..scaffold.structure import Scaffold

BLOCK = 256
"""Nodes whose poses at all times are worked on at once: a long clip has thousands."""


def continue_nodes(after: Scaffold, before: Scaffold, tolerance: float, next_id: int) -> Scaffold:
    """Return `after` with the ids and frames of those nodes of `before` that its own go on with; the others get new ids.

    Both are in the same world and the same times, which overlap. Over the shared times a pair of nodes is related by one
    rigid motion C as well as can be, `Q_before = Q_after C`; two nodes less than a unit apart whose poses then differ by at
    most `tolerance` (world units, on average; turns count by what they move a unit away) are parts of the same rigid thing,
    the best pairs first. Motions between two times do not know C, `Q(t) C (Q(r) C)^-1 = Q(t) Q(r)^-1`, so nothing that hangs
    on `after` moves. `next_id`: the first id that no node has had.
    """
    shared, here, there = np.intersect1d(after.times, before.times, return_indices=True)
    ids = np.full(len(after), -1, np.int64)
    xyz, quat = after.xyz.astype(np.float64), quaternion.normalize(after.quat.astype(np.float64))
    if len(shared):
        x, y = xyz[here], before.xyz[there].astype(np.float64)  # (S,A,3), (S,B,3)
        apart = np.linalg.norm(x[:, :, None] - y[:, None], axis=-1).mean(0)  # (A,B)
        a, b = np.nonzero(apart < before.unit)
        p, q = quat[here][:, a], quaternion.normalize(before.quat[there][:, b].astype(np.float64))
        turn, shift = pose.compose(*pose.invert(p, x[:, a]), q, y[:, b])  # (S,P,4), (S,P,3)
        turn, shift = quaternion.normalize(quaternion.align_sequence(turn).mean(0)), shift.mean(0)
        moved_q, moved_x = pose.compose(p, x[:, a], turn, shift)
        off = quaternion.to_rotation_vector(quaternion.multiply(moved_q, quaternion.conjugate(q)))
        differ = (np.linalg.norm(moved_x - y[:, b], axis=-1) + before.unit * np.linalg.norm(off, axis=-1)).mean(0)
        taken = np.zeros(len(before), bool)
        for pair in np.argsort(differ, kind="stable"):
            if differ[pair] > tolerance:
                break
            if ids[a[pair]] < 0 and not taken[b[pair]]:
                node = a[pair]
                ids[node], taken[b[pair]] = before.ids[b[pair]], True
                quat[:, node], xyz[:, node] = pose.compose(quat[:, node], xyz[:, node], turn[pair], shift[pair])
    fresh = ids < 0
    ids[fresh] = next_id + np.arange(fresh.sum())
    return replace(after, xyz=xyz.astype(np.float32), quat=align_signs(quat).astype(np.float32), ids=ids)


def join_scaffolds(parts: Sequence[Scaffold], spans: np.ndarray) -> tuple[Scaffold, list[np.ndarray]]:
    """Return (one scaffold at all times of `parts`, for each part the row of each of its nodes in it).

    Nodes with the same id are one node. `spans (P,4)` say when each part is there (`geometry.interpolation.presence`); where
    two are, the poses of the nodes that they share go over from one to the other. Before and after its parts a node stays
    where they begin and end.
    """
    times = np.unique(np.concatenate([part.times for part in parts]))
    ids, first = np.unique(np.concatenate([part.ids for part in parts]), return_index=True)
    rows = [np.searchsorted(ids, part.ids) for part in parts]
    slots = max(part.neighbours.shape[1] for part in parts)
    xyz, quat = np.zeros((len(times), len(ids), 3), np.float32), np.zeros((len(times), len(ids), 4), np.float32)
    total = np.zeros((len(times), len(ids)), np.float32)
    certain = np.zeros(total.shape, bool)
    radius, graph, mask = [], [], []
    for part, row, span in zip(parts, rows, spans, strict=True):
        at = np.ix_(np.searchsorted(times, part.times), row)
        # a part at whose very ends nothing is left of it still says where its nodes are then
        weight = np.maximum([presence(span[None], time)[0] for time in part.times], 1e-6)[:, None].astype(np.float32)
        sign = np.where((quat[at] * part.quat).sum(-1, keepdims=True) < 0, np.float32(-1), np.float32(1))
        xyz[at] += weight[..., None] * part.xyz
        quat[at] += weight[..., None] * sign * part.quat
        total[at] += weight
        certain[at] |= part.certain
        padding = slots - part.neighbours.shape[1]
        graph.append(np.concatenate([row[part.neighbours], np.repeat(row[:, None], padding, 1)], 1))
        mask.append(np.pad(part.edge_mask, ((0, 0), (0, padding))))
        radius.append(part.radius)
    known = total > 0
    start, end = known.argmax(0), len(times) - 1 - known[::-1].argmax(0)
    for first_of in range(0, len(ids), BLOCK):
        block = slice(first_of, first_of + BLOCK)
        nearest = np.clip(np.arange(len(times))[:, None], start[block], end[block])[..., None]  # (F,B,1)
        weights = np.take_along_axis(total[:, block, None], nearest, 0)
        xyz[:, block] = np.take_along_axis(xyz[:, block], nearest, 0) / weights
        turned = quaternion.normalize(np.take_along_axis(quat[:, block], nearest, 0))
        quat[:, block] = quaternion.align_sequence(turned)
    neighbours, edge_mask = np.concatenate(graph)[first], np.concatenate(mask)[first]
    along_graph = (align_signs(quat[:1], neighbours, edge_mask) * quat[:1]).sum(-1, keepdims=True)
    quat *= np.where(along_graph < 0, np.float32(-1), np.float32(1))
    joined = Scaffold(
        times=times,
        xyz=xyz,
        quat=quat,
        radius=np.concatenate(radius)[first],
        certain=certain,
        ids=ids,
        neighbours=neighbours,
        edge_mask=edge_mask,
        unit=float(np.median([part.unit for part in parts])),
    )
    return joined, rows
