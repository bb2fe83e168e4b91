"""An object that leaves the picture and comes back.

Hard: for some frames nothing moves; then the same thing enters again where it left.

Why: tracks end, masks are empty in between, and curves are carried on through frames in which nobody saw them.

Must hold: unseen frames are right, or it is said that what moves is worse, or carried by too few nodes.
"""

from .common.film import Card, checks, film, np, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    def place(time):
        return np.array([0.15 + 0.6 * np.sin(np.pi * time / 13) ** 2, -0.02, 0.8])

    card = Card(checks(0.2, 4.0), (0.1, 0.1), place, moves=True)
    yield from judge(fit(film(room(card), frames=14)), "What moves is|near a motion node|can be followed")
