"""A mask that is full everywhere.

Hard: the user's masks say that every pixel moves.

Why: there is no background to find cameras by, and no static Gaussian to begin with.

Must hold: it fits, and it is said that the background is hardly seen.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import film, mover, room
from .common.fitting import fit, judge, np

STAGE, SLOW = "fit", True


def check():
    shot = film(room(mover()))
    fitted = fit(shot, mask=np.ones_like(shot.mask))
    yield from judge(fitted, "picture counts as moving")
    yield reported("everything moves", "picture counts as moving", fitted.messages)
