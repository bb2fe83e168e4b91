"""A control radius of zero.

Hard: nodes whose radius shrank to 0 carry points on them and points beside them.

Why: exp(-d^2 / 2 r^2) divides by 0; on the node that is 0 / 0.

Must hold: values and gradients are finite and those of float64.
"""

from .common.carrying import compare, np, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    radius = carried.leaves["radius"].copy()
    radius[::2] = 0
    local = carried.leaves["local_xyz"].copy()
    local[::3] = 0  # on the attach node
    yield from compare(carried.with_(radius=radius, local_xyz=local))
    yield from compare(carried.with_(radius=np.zeros_like(radius), local_xyz=local))
