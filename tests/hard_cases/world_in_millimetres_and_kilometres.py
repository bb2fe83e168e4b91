"""Cameras and depth in millimetres, and in thousands of metres.

Hard: what the user gives is 1024 times smaller or larger than in another run.

Why: learning rates, node spacings and near planes are lengths.

Must hold: the world is brought to median depth 1, both come out as good, and as each other: powers of 2 round nothing.
"""

from benchmarks.studies.hard_cases import within

from .common.film import film, mover, room
from .common.fitting import fit, judge, np

STAGE, SLOW = "fit", True


def check():
    shot = film(room(mover()))
    scores = []
    for scale in (2.0**-10, 2.0**10):
        fitted = fit(shot, cameras=shot.cameras.scaled_world(scale), depth=(scale * shot.depth).astype(np.float32))
        yield from judge(fitted)
        depth = float(np.nanmedian(fitted.priors.depth))
        yield within(f"scale {scale:g}: median depth, from 1", abs(depth - 1), 0.01)
        scores.append(fitted.psnr)
    yield within("difference of the two, dB", abs(scores[0] - scores[1]), 1e-6)
