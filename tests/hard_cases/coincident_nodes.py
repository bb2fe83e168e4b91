"""Nodes in one place.

Hard: all neighbours of a Gaussian are the same point with the same path, two slots even the same node.

Why: distances between nodes are 0 and a rotation cannot be found from them; a node listed twice counts twice.

Must hold: weights sum to 1, and values and gradients are those of float64.
"""

from .common.carrying import compare, np, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    xyz = carried.leaves["node_xyz"].copy()
    xyz[:, 1:] = xyz[:, :1]
    neighbours = carried.neighbours.copy()
    neighbours[:20, 1] = neighbours[:20, 0]
    yield from compare(carried.with_(node_xyz=xyz, neighbours=neighbours))
    yield from compare(carried.with_(node_xyz=xyz, local_xyz=np.zeros_like(carried.leaves["local_xyz"])))
