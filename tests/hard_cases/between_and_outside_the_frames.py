"""Times between, before and after the clip's frames.

Hard: slow motion asks for every instant, and retiming for instants that were never filmed; the frames are uneven.

Why: cubic curves run away outside their knots and swing where knots crowd.

Must hold: the forms agree with float64, and outside the clip the motion comes to rest.
"""

import numpy as np

from benchmarks.studies.hard_cases import within

from .common.carrying import carry_plainly, compare, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(2.0).with_(times=np.array([0.0, 1, 1.25, 7, 8]))
    for time in (-50.0, 0.6, 1.1, 4.0, 8.4, 200.0):
        yield from compare(carried, time)
    places = [differentiate(carry_plainly, carried, time, torch.float64)[0][0] for time in (500.0, 1000.0)]
    yield within("at rest long after the end", abs(places[0] - places[1]).max(), 1e-9)
