"""A mirror.

Hard: behind a window in the wall everything is seen a second time, turned over, beyond the wall - the mover too.

Why: what is seen in a mirror has the parallax of a place behind the wall, where depth and masks expect nothing.

Must hold: unseen frames are right, the mirrored world being taken for a real one behind a hole, or the cause is said.
"""

from dataclasses import replace

from .common.film import Card, checks, film, mover, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    glass = 1.5  # depth of the mirror
    card = mover()
    image = replace(card, at=lambda time: card.at(time) * [1, 1, -1] + [0, 0, 2 * glass])
    wall = [Card(checks(0.57), (0.5, 2), standing(side * 0.85, 0, glass)) for side in (-1, 1)]
    back = Card(checks(0.9, 0.7), at=standing(0, 0, 3.6))
    cards = [*wall, back, image, *room(card)[1:]]
    yield from judge(fit(film(cards).clip), "What moves|Even the frames|moved very little|can be followed")
