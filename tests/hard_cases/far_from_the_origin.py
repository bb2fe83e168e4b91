"""A scaffold far from the origin.

Hard: everything happens a hundred scene sizes away from 0 0 0.

Why: a dual quaternion turns about the origin; the turn's rounding is multiplied by the distance.

Must hold: places are as exact as float32 can hold them there (6e-8 of the distance, a few times over).
"""

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    yield from compare(carried.with_(node_xyz=carried.leaves["node_xyz"] + [100, 0, 0]), gradient=5e-4)
