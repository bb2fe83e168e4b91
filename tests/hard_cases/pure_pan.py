"""A camera that only turns.

Hard: pictures move, but there is no parallax.

Why: an essential matrix exists for any baseline, and its depth is noise.

Must hold: the camera's own views are right, and it is said that depth is a guess.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import film, gliding, mover, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    fitted = fit(film(room(mover(0.02)), eye=standing(0, 0, 0), look=gliding((0, -0.11, 0), (0, 0.02, 0))))
    yield from judge(fitted)
    yield reported("depth is not known", "camera only turned", fitted.messages)
