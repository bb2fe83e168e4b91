"""A quaternion of length zero.

Hard: a Gaussian's or a node's quaternion is 0 0 0 0, as a fresh buffer or a diverged step leaves it.

Why: normalising divides by 0 and one NaN spoils a whole picture.

Must hold: it counts as no rotation, and gradients are finite.
"""

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    local, node = carried.leaves["local_quat"].copy(), carried.leaves["node_quat"].copy()
    local[::5], node[2, 3], node[:, 4] = 0, 0, 0
    yield from compare(carried.with_(local_quat=local, node_quat=node))
