"""An object that passes right before the camera.

Hard: a card at a fifth of the scene's depth fills most of the picture for some frames, moving by 17 pixels a frame.

Why: the background is hidden, flow cannot follow, and the mask covers nearly everything.

Must hold: no cut is seen where there is none, and it is said that points cannot be followed.
"""

from benchmarks.studies.hard_cases import that

from .common.film import Card, checks, film, gliding, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    card = Card(checks(0.2, 4.0), (0.12, 0.12), gliding((0.38, 0, 0.35), (-0.07, 0, 0)), moves=True)
    fitted = fit(film(room(card)))
    yield from judge(fitted, "can be followed")
    yield that("no cut is made up", not any("shots" in text for text in fitted.messages))
