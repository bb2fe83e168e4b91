"""An object that is hidden completely.

Hard: a card passes behind a broad post and comes out on the other side.

Why: the near post is taken to move and the wall behind it to be all there is, so the
camera only turns; the card's tracks stop at the post or, worse, go on along the post's edge.

Must hold: unseen frames are right, or it is said that points cannot be followed, or that what moves is worse than the rest.
"""

from benchmarks.studies.hard_cases import that

from .common.film import Card, checks, film, gliding, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    card = Card(checks(0.2, 4.0), (0.07, 0.07), gliding((-0.25, 0, 0.9), (0.045, 0, 0)), moves=True)
    post = Card(checks(0.15, 5.0), (0.13, 0.6), standing(0.0, 0, 0.7))
    fitted = fit(film(room(card, post), frames=12))
    yield from judge(fitted, "What moves is|can be followed")
    yield that("the post hides no camera", fitted.priors.camera_kind == "moving")
