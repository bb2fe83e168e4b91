"""Skinning of meshes: weights and blend of the Gaussians, and the linear blend that other programs have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import dual_quaternion, pose
from ...scaffold import Scaffold
from ...scaffold.deformation import blend, node_poses_at
from .simplify import edges_of, neighbour_means

JOINTS = 8
"""Nodes that a vertex follows in other programs, the strongest first: two of the sets of four that glTF knows."""
AROUND = 8
"""Gaussians that a vertex takes its weights from: fewer follow them better, more stretch less between two that part."""
EVENED = 5
"""Rounds in which the weights of a vertex go half-way to the mean of its neighbours'."""
LOOKED_AT = 20_000
"""Gaussians at most among which the nearest are looked for; of more, evenly so many."""
BLOCK = 1 << 22
"""Distances from vertices to Gaussians that are worked on together."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Nodes and weights of V vertices, placed at clip time `time`."""

    time: float
    """Clip time at which the vertices are where the mesh has them."""
    node: np.ndarray
    """(V,K) int32 rows of the scaffold's nodes, the heaviest first."""
    weight: np.ndarray
    """(V,K) float32 >= 0, sum 1, or 0 where a vertex follows nothing."""
    strength: np.ndarray
    """(V,) float32: 1 follows the nodes, 0 stays put."""

    @property
    def moves(self) -> bool:
        """True if any vertex follows a node."""
        return bool((self.strength > 0).any())

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (nodes (J,) that are used, joint (V,8), weight (V,8) float32 with sum 1) of a linear blend.

        A vertex follows the nodes with its largest weights. Joint number J does not move and has the weight `1 - strength`.
        """
        weight = np.concatenate([self.weight * self.strength[:, None], 1 - self.strength[:, None]], axis=1)
        node = np.concatenate([self.node, np.full((len(self.node), 1), -1)], axis=1)
        most = np.argsort(-weight, axis=1, kind="stable")[:, :JOINTS]
        weight, node = (np.take_along_axis(array, most, axis=1) for array in (weight, node))
        weight = np.pad(weight, ((0, 0), (0, JOINTS - weight.shape[1])))
        node = np.pad(node, ((0, 0), (0, JOINTS - node.shape[1])), constant_values=-1)
        used = np.unique(node[(weight > 0) & (node >= 0)])
        joint = np.where(node < 0, len(used), np.searchsorted(used, node))
        joint[weight == 0] = 0  # the rule of glTF
        return used, joint, (weight / weight.sum(1, keepdims=True)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Carriers:
    """Nodes and weights of N Gaussians."""

    means: np.ndarray
    """(N,3) where they are at the time of the skin."""
    opacities: np.ndarray
    """(N,) in (0, 1]."""
    node: np.ndarray
    """(N,K) rows of the scaffold's nodes."""
    weight: np.ndarray
    """(N,K) sum 1; 0 where a Gaussian follows nothing."""
    strength: np.ndarray
    """(N,) 0 for a Gaussian that stays put."""


def skin_of(vertices: np.ndarray, faces: np.ndarray, carriers: Carriers, time: float) -> Skin:
    """Let the vertices (V,3) of a mesh, as they are at clip time `time`, follow what the Gaussians around them follow.

    Each takes the mean weights of the `AROUND` nearest, by opacity and distance. These are evened out along the surface, for
    neighbours that follow different nodes stretch what is between them, and the K largest are kept.
    """
    picked = np.arange(0, len(carriers.means), -(-len(carriers.means) // LOOKED_AT))
    near, distance = _nearest(vertices, carriers.means[picked])
    near = picked[near]
    far = np.maximum(distance.max(1, keepdims=True), np.finfo(np.float32).tiny)
    fraction = carriers.opacities[near] * np.exp(-2 * (distance / far) ** 2)
    fraction *= carriers.strength[near] / fraction.sum(1, keepdims=True)
    nodes, column = np.unique(carriers.node, return_inverse=True)
    column = column.reshape(carriers.node.shape)
    total = np.zeros((len(vertices), len(nodes)), np.float32)
    for nth in range(near.shape[1]):
        rows = near[:, nth]
        own = fraction[:, nth, None] * carriers.weight[rows]
        np.add.at(total, (np.arange(len(rows))[:, None], column[rows]), own)
    ends = edges_of(faces)
    for _ in range(EVENED):
        total = (total + neighbour_means(total, ends)) / 2
    most = np.argsort(-total, axis=1, kind="stable")[:, : carriers.node.shape[1]]
    weight, strength = np.take_along_axis(total, most, axis=1), np.clip(total.sum(1), 0, 1)
    weight /= np.maximum(weight.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    return Skin(time, nodes[most].astype(np.int32), weight.astype(np.float32), strength.astype(np.float32))


def _nearest(points: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (indices (P,k) of the `AROUND` nearest of `others (N,3)`, in no order; distances (P,k))."""
    count = min(AROUND, len(others))
    centre = others.mean(0)  # the shorter vectors are, the less their squares round
    points, others = (points - centre).astype(np.float32), (others - centre).astype(np.float32)
    squares = (others**2).sum(1)
    index = np.empty((len(points), count), np.int64)
    step = max(1, BLOCK // len(others))
    for first in range(0, len(points), step):
        block = slice(first, first + step)
        index[block] = np.argpartition(squares - 2 * points[block] @ others.T, count - 1, axis=1)[:, :count]
    return index, np.linalg.norm(points[:, None] - others[index], axis=2)


def carried(vertices: np.ndarray, skin: Skin, scaffold: Scaffold, time: float) -> np.ndarray:
    """Return the vertices (V,3) at clip time `time`, moved by the blend that moves Gaussians (dual quaternions)."""
    if not skin.moves:
        return vertices
    x, q = pose.compose(*_poses(scaffold, time), *pose.invert(*_poses(scaffold, skin.time)))[::-1]
    table = dual_quaternion.from_pose(q, x)
    return pose.transform(*blend(table, skin.node, skin.weight, skin.strength), vertices)


def linearly_carried(vertices: np.ndarray, skin: Skin, scaffold: Scaffold, time: float) -> np.ndarray:
    """Return the vertices (V,3) at clip time `time` as programs have them that read the glTF file."""
    used, joint, weight = skin.joints()
    q, x = pose.compose(*_poses(scaffold, time), *pose.invert(*_poses(scaffold, skin.time)))
    motions = np.concatenate([pose.to_matrix(q, x)[used], np.eye(4)[None]])[:, :3]
    whole = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    moved = np.zeros((len(vertices), 3))
    for slot in range(joint.shape[1]):
        moved += weight[:, slot, None] * (motions[joint[:, slot]] @ whole[..., None])[..., 0]
    return moved


def deviation(vertices: np.ndarray, skin: Skin, scaffold: Scaffold, times: np.ndarray) -> np.ndarray:
    """Return (T,V) how far a linear blend puts the vertices from where the scaffold carries them, world units."""
    pairs = (
        (carried(vertices, skin, scaffold, time), linearly_carried(vertices, skin, scaffold, time)) for time in times
    )
    return np.array([np.linalg.norm(own - linear, axis=1) for own, linear in pairs])


def _poses(scaffold: Scaffold, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotations (M,4) and places (M,3) float64 of the nodes."""
    xyz, quat = node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, time)
    return quat.astype(np.float64), xyz.astype(np.float64)
