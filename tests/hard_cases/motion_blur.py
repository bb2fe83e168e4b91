"""Motion blur.

Hard: the shutter is open all the time, and the object moves by a third of its size a frame.

Why: a blurred edge is no surface; flow and tracks lose what has no detail left.

Must hold: unseen frames are right, or it is said that what moves is worse or cannot be followed.
"""

from .common.film import film, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    yield from judge(fit(film(room(mover(0.04)), shutter=1.0)), "What moves is|can be followed")
