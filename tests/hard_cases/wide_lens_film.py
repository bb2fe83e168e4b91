"""A film through a lens of 0.2 picture widths.

Hard: 136 degrees across; things are small and the picture's edges are stretched.

Why: focal lengths that short are outside the usual search.

Must hold: unseen frames are right, or it is said that the lens may be wider than any that was tried, or hardly
known.
"""

from .common.film import film, mover, room, sideways
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    clip = film(room(mover(0.03)), focal=0.2, eye=sideways(0.05))
    yield from judge(fit(clip, lens_known=False), "the lens may be wider|hardly tell the focal length")
