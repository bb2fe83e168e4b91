"""A quaternion of length zero.

Hard: a Gaussian's or a node's quaternion is 0 0 0 0, as a fresh buffer or a diverged step leaves it.

Why: normalising divides by 0 and one NaN spoils a whole picture.

Must hold: it counts as no rotation, and gradients are finite.
"""

import numpy as np

from benchmarks.studies.hard_cases import within

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    local, node = carried.leaves["local_quat"].copy(), carried.leaves["node_quat"].copy()
    local[::5], node[2, 3], node[:, 4] = 0, 0, 0
    zero = carried.with_(local_quat=local, node_quat=node)
    yield from compare(zero)
    unturned = [np.where(abs(q).max(-1, keepdims=True) > 0, q, [1.0, 0, 0, 0]) for q in (local, node)]
    unturned = carried.with_(local_quat=unturned[0], node_quat=unturned[1])
    got, expected = (differentiate(carry_plainly, one, 4.0, torch.float64)[0] for one in (zero, unturned))
    worst = max(abs(a - b).max() for a, b in zip(got, expected, strict=True))
    yield within("places and turns, from those of no rotation", worst, 1e-12)
