"""A rolling shutter.

Hard: the last row is read a whole frame later than the first, while the camera slides fast.

Why: no camera at all explains such a picture; uprights lean.

Must hold: unseen frames are right, or it is said that cameras or frames do not fit.
"""

from .common.film import film, gliding, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    clip = film(room(mover()), eye=gliding((-0.18, 0, 0), (0.04, 0, 0)), readout=1.0).clip
    yield from judge(fit(clip), "cameras miss|Cameras or motion|Even the frames")
