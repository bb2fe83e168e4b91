"""The scaffold as arrays: what the scene file stores and every other module of this room reads."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import Array


class NodePoses(NamedTuple):
    """Poses of M nodes at F times; numpy or torch."""

    xyz: Array
    """(F, M, 3) world units."""
    quat: Array
    """(F, M, 4) wxyz."""


@dataclass(frozen=True, eq=False)
class Scaffold:
    """M nodes with poses at F times; a node's pose maps its local coordinates to the world, `x_world = R x + t`."""

    times: np.ndarray
    """(F,) float64, clip frames, strictly increasing."""
    xyz: np.ndarray
    """(F, M, 3) float32, node positions in world units."""
    quat: np.ndarray
    """(F, M, 4) float32, node rotations wxyz, neighbours in time on one hemisphere."""
    radius: np.ndarray
    """(M,) float32, control radius (sigma of the skinning kernel) in world units."""
    certain: np.ndarray
    """(F, M) bool, True where a track was seen at the node or near it; elsewhere its position is filled in."""
    ids: np.ndarray
    """(M,) int64, never reused."""
    neighbours: np.ndarray
    """(M, K) int64, the node itself first, then its nearest nodes by curve distance."""
    edge_mask: np.ndarray
    """(M, K) bool, False for padding and for neighbours out of reach; the self edge is always True."""
    unit: float
    """Node spacing in world units; radii, graph reach and thinning are multiples of it."""

    def __post_init__(self):
        """Refuse shapes that do not fit together, times that do not increase and neighbours that do not exist."""
        frames, nodes, _ = self.xyz.shape
        slots = self.neighbours.shape[1]
        expected = {
            "times": (frames,),
            "xyz": (frames, nodes, 3),
            "quat": (frames, nodes, 4),
            "radius": (nodes,),
            "certain": (frames, nodes),
            "ids": (nodes,),
            "neighbours": (nodes, slots),
            "edge_mask": (nodes, slots),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise F4xError(f"scaffold {name} has shape {getattr(self, name).shape}; it should be {shape}")
        if frames == 0 or (np.diff(self.times) <= 0).any():
            raise F4xError("a scaffold needs at least one time, and times that strictly increase")
        if not (np.isfinite(self.xyz).all() and np.isfinite(self.quat).all()):
            raise F4xError("scaffold poses hold numbers that are not finite; build the scaffold again")
        if nodes and not 0 <= self.neighbours.min() <= self.neighbours.max() < nodes:
            raise F4xError(f"scaffold neighbours should be node indices below {nodes}; build the graph again")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def edges(self) -> np.ndarray:
        """(E, 2) int64 pairs of nodes that the graph joins, each once, the smaller index first."""
        start = np.broadcast_to(np.arange(len(self))[:, None], self.neighbours.shape)[self.edge_mask]
        pairs = np.sort(np.stack([start, self.neighbours[self.edge_mask]], axis=1), axis=1)
        return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
