"""An object that turns on the spot.

Hard: a disc turns by 63 degrees about its middle; its outline does not change at all.

Why: nodes that know positions alone see little motion, and rotations have to be found from neighbours.

Must hold: unseen frames are right, and views aside too, or the depth of the disc is called a guess.
"""

from .common.film import Card, checks, film, gliding, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    turn = gliding((0, 0, 0), (0, 0, 0.1))
    disc = Card(checks(0.15, 4.0), (0.15, 0.15), standing(0.05, -0.03, 0.8), turn, moves=True, disc=True)
    yield from judge(fit(film(room(disc))), "The depth of what moves is a guess")
