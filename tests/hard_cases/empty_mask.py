"""A mask that is empty everywhere.

Hard: the user's masks say that nothing moves, though something does.

Why: no moving pixel means no track, no scaffold, no dynamic Gaussian; means over nothing.

Must hold: a static scene, and it is said that nothing was taken to move.
"""

from benchmarks.studies.hard_cases import reported, that

from .common.film import film, mover, room
from .common.fitting import fit, judge, np

STAGE, SLOW = "fit", True


def check():
    shot = film(room(mover()))
    fitted = fit(shot, mask=np.zeros_like(shot.mask))
    yield from judge(fitted, "Nothing was taken to move")
    yield that("no dynamic Gaussian", len(fitted.scene.dynamic) == 0 and fitted.scene.scaffold is None)
    yield reported("nothing moves", "Nothing was taken to move", fitted.messages)
