"""A motion of two full turns.

Hard: nodes turn by 720 degrees in the clip, so that their quaternions run through both hemispheres twice.

Why: a rotation alone does not say how often it went round; a blend that takes every sign anew pops in the middle.

Must hold: at every quarter of a frame the forms agree with float64, and no Gaussian jumps between two of them.
"""

import numpy as np

from benchmarks.studies.hard_cases import that, within

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(4 * np.pi, spread=0.0, frames=17)
    for time in (4.0, 7.75, 12.5, 16.0):
        yield from compare(carried, time)
    places = [differentiate(carry_plainly, carried, t, torch.float64)[0][0] for t in np.arange(0, 16.01, 0.25)]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)  # (64, N)
    yield within("longest step, in median steps of the Gaussian", (steps.max(0) / np.median(steps, 0)).max(), 3.0)
    yield that("something moves", steps.min() > 0)
