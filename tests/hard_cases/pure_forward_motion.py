"""A camera that moves straight ahead.

Hard: the epipole lies in the middle of the picture, where nothing moves and depth cannot be seen.

Why: two views triangulate badly along the axis; the middle swallows or spits out depth.

Must hold: unseen frames are right, and views aside; a known limit: no better than half the error of the best picture without 3D.
"""

from .common.film import LEVEL, film, gliding, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    yield from judge(
        fit(film(room(mover()), eye=gliding((0, 0, -0.15), (0, 0, 0.03)), look=LEVEL)),
        known="forward motion leaves half of the error aside",
        at_most=1.1,
    )
