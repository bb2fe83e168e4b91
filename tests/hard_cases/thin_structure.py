"""A moving thing that is thinner than a pixel.

Hard: a bright wire, 0.9 pixels wide, moves by a pixel a frame.

Why: masks of so little are taken for specks, and flow does not see it.

Must hold: unseen frames are right but for the wire; it is said what share moves, or that nothing does.
"""

from .common.film import Card, film, gliding, plain, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    wire = Card(plain(0.95, 0.95, 0.95), (0.004, 0.4), gliding((0.08, 0, 0.8), (-0.01, 0, 0)), moves=True)
    yield from judge(
        fit(film(room(wire)).clip), "Nothing was taken to move|What moves|camera only turned|moved very little"
    )
