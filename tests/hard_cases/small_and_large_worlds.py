"""Scaffolds a thousand times smaller and larger.

Hard: given cameras bring their own unit: a world in kilometres or in millimetres.

Why: constants that mean a length - floors, tolerances, learning rates - are then a thousand times off.

Must hold: the motion scales with the world, alike in both precisions.
"""

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    for scale in (1e-3, 1e3):
        lengths = {name: scale * carried.leaves[name] for name in ("local_xyz", "node_xyz", "radius")}
        yield from compare(carried.with_(**lengths), gradient=2e-4)
