"""A camera that stands still.

Hard: nothing tells how far things are.

Why: structure from motion fails or invents a motion, and depth from it is arbitrary.

Must hold: the original view is right, and it is said that no other can be believed.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import LEVEL, film, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    fitted = fit(film(room(mover(0.02)), eye=LEVEL, look=LEVEL))
    yield from judge(fitted)
    yield reported("depth is not known", "camera stood still", fitted.messages)
