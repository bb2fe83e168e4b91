"""Dynamic Gaussians carried by nodes that stand where a caller says: where an artist's empties are, not where the scaffold is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import dual_quaternion, pose, quaternion
from ..scaffold.deformation import move_gaussians, pairs_of
from .model import Scene


@dataclass(frozen=True, eq=False)
class Carried:
    """N dynamic Gaussians where the scaffold has carried them, float32."""

    means: np.ndarray
    """(N,3) centres."""
    quats: np.ndarray
    """(N,4) wxyz."""
    turns: np.ndarray
    """(N,4) unit: what the motion added to their rotation at rest."""


class Carrier:
    """The dynamic Gaussians of a scene and the poses of its scaffold at their reference times, prepared once."""

    def __init__(self, scene: Scene):
        assert scene.scaffold is not None  # a scene with dynamic Gaussians has one
        self._gaussians, scaffold = scene.dynamic, scene.scaffold
        self._pairs = pairs_of(self._gaussians.node, self._gaussians.reference)
        then = self._pairs.reference, self._pairs.node
        self._back = pose.invert(quaternion.normalize(scaffold.quat[then]), scaffold.xyz[then])
        self._unturned = quaternion.conjugate(quaternion.normalize(self._gaussians.quats))

    def carried(self, xyz: np.ndarray, quat: np.ndarray) -> Carried:
        """Return Gaussians with nodes at `xyz (M,3)`, `quat (M,4)` unit; with the scaffold's own poses those of `Scene.posed`."""
        node, gaussians = self._pairs.node, self._gaussians
        table = dual_quaternion.from_pose(*pose.compose(quat[node], xyz[node], *self._back)).astype(np.float32)
        means, quats = move_gaussians(
            table, self._pairs.index, gaussians.weight, gaussians.strength, gaussians.means, gaussians.quats
        )
        turns = quaternion.multiply(quaternion.normalize(quats), self._unturned)
        return Carried(means, quats, turns.astype(np.float32))
