"""A lens that nobody knows.

Hard: an ordinary film of 96 by 56 pixels whose focal length has to be found out.

Why: a slightly longer lens and a slightly deeper world fit tracks nearly as well, so that noise chooses among them; frames of
the path look right with any, views aside do not.

Must hold: cameras and views aside are right, or it is said that the pictures hardly tell the focal length.
"""

from .common.film import film, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    yield from judge(fit(film(room(mover())), lens_known=False), "hardly tell the focal length")
