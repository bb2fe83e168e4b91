"""A scaffold of a thousand frames.

Hard: twenty turns in a clip of 1000 frames, of which a Gaussian's reference may be any.

Why: whatever is chained from frame to frame adds up its rounding, and signs lost once stay lost.

Must hold: frame 999 is as exact as frame 1, and stored signs stay continuous all the way.
"""

import numpy as np

from benchmarks.studies.hard_cases import that
from f4x_core.scaffold.deformation import align_signs

from .common.carrying import compare, turning

STAGE = "deformation"


def check():
    carried = turning(40 * np.pi, frames=1000)
    reference = np.random.default_rng(0).integers(0, 1000, len(carried.reference))
    for time in (1.0, 500.5, 999.0):
        yield from compare(carried.with_(reference=reference), time)
    rng = np.random.default_rng(1)
    stored = carried.leaves["node_quat"] * rng.choice([-1, 1], (*carried.leaves["node_quat"].shape[:2], 1))
    aligned = align_signs(stored.astype(np.float32))
    yield that("signs are continuous again", ((aligned[1:] * aligned[:-1]).sum(-1) > 0).all())
