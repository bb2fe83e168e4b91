"""A hard cut inside the clip.

Hard: from frame 5 on another place is seen.

Why: one scene is made of two, and every camera of the second half is invented.

Must hold: it is said that the clip holds two shots, and at which frame to part them.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import Card, checks, film, mover, room, standing
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True


def check():
    other = [
        Card(checks(0.3, 2.5), at=standing(0, 0, 1.2)),
        Card(checks(0.2, 0.5), (0.2, 0.2), standing(0.1, 0.1, 0.8)),
    ]
    fitted = fit(film(room(mover()), cut_to=(5, other)))
    yield from judge(fitted, "2 shots")
    yield reported("where to part it", "2 shots, cut at frame 5", fitted.messages)
