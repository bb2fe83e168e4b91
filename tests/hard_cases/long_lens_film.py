"""A film through a lens of 5 picture widths.

Hard: 11 degrees across: nearly an orthographic view, in which focal length and depth trade places.

Why: outside the usual search of focal lengths; a wrong one bends the world.

Must hold: unseen frames are right, whatever focal length was found, or it is said that the pictures hardly tell it. A known limit:
in small pictures it is taken for a wide lens, and the scene is flat.
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
    eye, look = gliding((-0.022, 0, 0), (0.004, 0, 0)), gliding((0, 0.018, 0), (0, -0.0033, 0))
    clip = film([wall, post, card], focal=5, eye=eye, look=look)
    yield from judge(
        fit(clip, lens_known=False),
        "hardly tell the focal length",
        known="a lens of 11 degrees is taken for a wide one",
        at_most=9,
    )
