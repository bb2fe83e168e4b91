"""Water.

Hard: the floor ripples: its texture swims in waves that nothing rigid follows.

Why: as-rigid-as-possible is wrong for it, tracks on it wander, and it moves everywhere at once.

Must hold: unseen frames are right, or it is said that what moves is worse.
"""

from .common.film import Card, checks, film, mover, np, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    def ripple(time):
        return np.array([np.pi / 2 + 0.06 * np.sin(0.9 * time), 0, 0])

    cards = room(mover())
    cards[1] = Card(checks(0.3, 1.0), at=standing(0, 0.2, 1), turn=ripple, moves=True)
    known = "part of the ripples is taken to stand still and blurs, and no sentence names them"
    yield from judge(fit(film(cards)), "What moves is|can be followed|picture counts as moving", known, at_most=2)
