"""A rolling shutter.

Hard: the last row is read a whole frame later than the first, while the camera slides fast.

Why: no camera at all explains such a picture; uprights lean.

Must hold: unseen frames are right, or it is said that the cameras miss the points they see.
"""

from .common.film import film, mover, room, sideways
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    clip = film(room(mover()), eye=sideways(0.04), readout=1.0)
    known = (
        "a shutter that takes a frame to read bends the path and the depth by too little to show in the cameras' error"
    )
    yield from judge(fit(clip), "cameras miss", known, at_most=2)
