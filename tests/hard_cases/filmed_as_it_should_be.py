"""An easy film, to judge the others by.

Hard: nothing. A camera slides past a slanting wall, a floor and two posts, while one card glides through.

Why: a case that is hard only because films are small would prove nothing.

Must hold: unseen frames are right, the camera counts as moving, something moves and no cut or exposure is spoken of.
"""

from benchmarks.studies.hard_cases import that

from .common.film import film, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    fitted = fit(film(room(mover())))
    yield from judge(fitted)
    yield that("the camera moves", fitted.priors.camera_kind == "moving")
    yield that("something moves", len(fitted.scene.dynamic) > 0)
    yield that("no false alarm", not any("shots" in text or "exposure" in text for text in fitted.messages))
