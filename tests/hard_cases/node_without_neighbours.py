"""A node without neighbours.

Hard: a Gaussian's attach node has no other node in reach, all other slots are padding.

Why: padding points to some node; if its weight is not exactly 0 the Gaussian is torn away.

Must hold: the Gaussian moves rigidly with its one node, whatever stands in the padding.
"""

import numpy as np

from benchmarks.studies.hard_cases import within
from f4x_core.geometry import pose, quaternion

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(2.0)
    alone = np.zeros_like(carried.mask)
    alone[:, 0] = True
    carried = carried.with_(mask=alone)
    yield from compare(carried)
    (places, _), _ = differentiate(carry_plainly, carried, 4.0, torch.float64)
    node = carried.neighbours[:, 0]
    turn = quaternion.normalize(carried.leaves["node_quat"][4, node])
    rigid = pose.transform(turn, carried.leaves["node_xyz"][4, node], carried.leaves["local_xyz"])
    yield within("rigid with its node", abs(places - rigid).max(), 1e-12)
