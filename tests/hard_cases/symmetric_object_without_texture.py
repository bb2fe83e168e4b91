"""A turning disc of one colour.

Hard: nobody can see that it turns.

Why: tracks on it slip, motion masks are empty, and a motion is made up.

Must hold: unseen frames are right, for what cannot be seen need not be known; views aside too, or the depth of the disc is
called a guess.
"""

from .common.film import Card, film, gliding, plain, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    turn = gliding((0, 0, 0), (0, 0, 0.3))
    disc = Card(plain(0.8, 0.8, 0.2), (0.13, 0.13), standing(0.05, -0.03, 0.8), turn, moves=True, disc=True)
    yield from judge(fit(film(room(disc))), "The depth of what moves is a guess")
