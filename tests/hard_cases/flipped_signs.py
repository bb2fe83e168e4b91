"""Stored quaternions of either sign and any length.

Hard: what a file, an optimiser or Blender gives back: q or -q, and not of unit length.

Why: both stand for one rotation, and a blend that takes them as they come cancels.

Must hold: the motion at a clip frame does not depend on them.
"""

import numpy as np

from benchmarks.studies.hard_cases import within

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(2.0)
    rng = np.random.default_rng(1)
    quat = carried.leaves["node_quat"]
    changed = carried.with_(node_quat=quat * rng.choice([-3.0, -0.1, 0.5, 2.0], (*quat.shape[:2], 1)))
    yield from compare(changed)
    plain, other = (differentiate(carry_plainly, c, 4.0, torch.float64)[0] for c in (carried, changed))
    yield within("the same motion", max(abs(a - b).max() for a, b in zip(plain, other, strict=True)), 1e-12)
