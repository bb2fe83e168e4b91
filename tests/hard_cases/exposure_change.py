"""An exposure that falls to half.

Hard: a phone darkens the picture by 5 % with every frame.

Why: the same thing has another colour in every frame; the scene becomes their mean, or view-dependent.

Must hold: it is said that the exposure changes, and by how much.
"""

from benchmarks.studies.hard_cases import reported, within

from .common.film import film, mover, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    clip = film(room(mover()), gain=lambda time: 1 - 0.045 * time)
    fitted = fit(clip)
    yield from judge(fitted, "exposure changes")
    yield reported("the exposure is spoken of", "exposure changes", fitted.messages)
    found = fitted.priors.statistics["changes"]["exposure"]
    yield within("by how much, relative", abs(found / (1 / (1 - 0.045 * 11)) - 1), 0.2)
