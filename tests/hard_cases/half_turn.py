"""Exactly half a turn.

Hard: all nodes have turned by 180 degrees, where w is 0 and its sign is decided by rounding.

Why: the logarithm of a rotation and the hemisphere of a quaternion both break there; gradients become NaN.

Must hold: values and gradients are finite and those of float64.
"""

import numpy as np

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    yield from compare(turning(np.pi, spread=0.0))
