"""Neighbours whose turns lie on both sides of half a turn.

Hard: of the nodes that carry one Gaussian some have turned by less than 180 degrees, some by more.

Why: q and -q are one rotation; quaternions made with w >= 0 then point to opposite hemispheres, cancel in the blend, and a
turn of 178 degrees comes out as none.

Must hold: every form gives the turn in between, in float32 as in float64, with the right gradients.
"""

import numpy as np

from benchmarks.studies.hard_cases import that

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(np.deg2rad(179), spread=0.03)
    yield from compare(carried)
    (_, turns), _ = differentiate(carry_plainly, carried, 4.0, torch.float64)
    (_, before), _ = differentiate(carry_plainly, carried, 0.0, torch.float64)
    cosines = (np.trace(turns @ before.transpose(0, 2, 1), axis1=1, axis2=2) - 1) / 2
    yield that("every Gaussian turns by 173 to 180 degrees", (np.rad2deg(np.arccos(cosines.clip(-1, 1))) > 173).all())
