"""A film through a lens of 0.2 picture widths.

Hard: 136 degrees across; things are small and the picture's edges are stretched.

Why: focal lengths that short are outside the usual search.

Must hold: unseen frames are right, or it is said that cameras or frames do not fit.
"""

from .common.film import film, gliding, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    clip = film(room(mover(0.03)), focal=0.2, eye=gliding((-0.2, 0, 0), (0.05, 0, 0))).clip
    yield from judge(fit(clip), "Even the frames|cameras miss|Nothing was taken")
