"""Neighbours that turned in opposite directions.

Hard: two nodes carry one Gaussian in equal parts, one turned by +90 degrees, the other by -90: there is no middle.

Why: the blend has length 0 and any direction is as good; normalised it is noise that jumps from frame to frame.

Must hold: the answer is finite and near the middle of all that is possible, and gradients are finite.
"""

import numpy as np

from f4x_core.report.studies.hard_cases import that

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
    for name, function in {"torch": _by_torch, "native": _by_library}.items():
        for time in (3.999, 4.0):
            (places, turns), gradients = differentiate(function, carried, time, torch.float32)
            extent = np.linalg.norm(carried.leaves["local_xyz"], axis=1)
            yield that(
                "no farther than a turn can bring it", (np.linalg.norm(places, axis=1) < 1.001 * extent).all(), name
            )
            yield that("turns are turns", np.allclose(np.linalg.det(turns), 1, atol=1e-4), name)
            yield that("gradients are finite", all(np.isfinite(g).all() for g in gradients.values()), name)
