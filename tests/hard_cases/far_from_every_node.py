"""A point far from every node.

Hard: a Gaussian a thousand radii away from all that could carry it.

Why: every exponential underflows to 0 in float32 at 13 radii, in float64 at 38: the sum is 0 or nodes weigh by rounding.

Must hold: the floor under the weights makes it follow its neighbours in equal parts, alike in both precisions.
"""

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    for radii in (13, 40, 1000):
        local = carried.leaves["local_xyz"].copy()
        local[::2] *= radii * 0.5 / 0.35
        yield from compare(carried.with_(local_xyz=local), value=2e-5, gradient=2e-4)
