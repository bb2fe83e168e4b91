"""Neighbours that turned in opposite directions.

Hard: nodes carry one Gaussian in equal parts, half of them turned by up to +90 degrees, the others by -90: their quaternions
become orthogonal, and no turn is as much in the middle as half a turn.

Why: the signs with which they are added are a matter of rounding; a blend of other signs jumps, or has length 0.

Must hold: no turn up to 90 degrees; at 90 one of the two middles, none of the turns between; finite gradients.
"""

import numpy as np

from benchmarks.studies.hard_cases import that, within

from .common.carrying import _by_library, _by_torch, differentiate, quaternion, torch, turning

STAGE = "deformation"


def check():
    carried = turning(0.0)
    share = np.linspace(0, 1, 5)[:, None, None]
    half_turns = np.where(np.arange(10) % 2, 1, -1)[:, None] * [0, 0, np.pi / 2]
    neighbours = np.tile([0, 1, 2, 3], (len(carried.neighbours), 1))
    carried = carried.with_(
        node_quat=quaternion.from_rotation_vector(share * half_turns),
        neighbours=neighbours,
        node_xyz=np.zeros_like(carried.leaves["node_xyz"]),
        radius=np.full(10, 0.5),
    )
    node_turn = carried.leaves["node_quat"][carried.reference, 0]  # all slots attach to node 0
    at_rest = quaternion.to_matrix(quaternion.multiply(node_turn, quaternion.normalize(carried.leaves["local_quat"])))
    for name, function in {"torch": _by_torch, "native": _by_library}.items():
        for time in (3.999, 4.0):
            (places, turns), gradients = differentiate(function, carried, time, torch.float32)
            extent = np.linalg.norm(carried.leaves["local_xyz"], axis=1)
            yield that(
                "no farther than a turn can bring it", (np.linalg.norm(places, axis=1) < 1.001 * extent).all(), name
            )
            moved = turns @ at_rest.transpose(0, 2, 1)
            none, half = (abs(moved - middle).max((1, 2)) for middle in (np.eye(3), np.diag([-1, -1, 1])))
            away = np.where(time < 4, none, np.minimum(none, half))
            yield within("from the middle, entries of rotation matrices", away.max(), 1e-4, name)
            yield that("turns are turns", np.allclose(np.linalg.det(turns), 1, atol=1e-4), name)
            yield that("gradients are finite", all(np.isfinite(g).all() for g in gradients.values()), name)
