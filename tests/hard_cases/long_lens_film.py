"""A film through a lens of 5 picture widths.

Hard: 11 degrees across: nearly an orthographic view, in which focal length and depth trade places.

Why: outside the usual search of focal lengths; a wrong one bends the world.

Must hold: unseen frames are right, whatever focal length was found, or it is said that the cameras do not fit.
"""

from .common.film import Card, checks, film, gliding, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    wall, post = (
        Card(checks(0.1), at=standing(0, 0, 1.5)),
        Card(checks(0.05, 2.0), (0.02, 0.2), standing(-0.05, 0, 1.0)),
    )
    card = Card(checks(0.05, 4.0), (0.025, 0.025), gliding((0.02, 0, 0.9), (-0.002, 0.001, 0)), moves=True)
    clip = film([wall, post, card], focal=5, eye=gliding((-0.02, 0, 0), (0.004, 0, 0))).clip
    yield from judge(fit(clip), "Even the frames|cameras miss")
