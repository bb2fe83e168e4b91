"""Depth that is mostly NaN.

Hard: a sensor that sees only every fifth pixel and nothing at all of the mover; then one that sees nothing.

Why: one NaN in a loss spoils every parameter; lifting a track without depth puts it at the camera.

Must hold: holes are said and stepped over; no depth at all is refused with advice.
"""

from benchmarks.studies.hard_cases import refused, reported

from .common.film import film, mover, room
from .common.fitting import fit, judge, np

STAGE, SLOW = "fit", True


def check():
    shot = film(room(mover()))
    holes = np.where(np.random.default_rng(0).random(shot.depth.shape) < 0.8, np.nan, shot.depth).astype(np.float32)
    holes[shot.mask] = np.nan
    fitted = fit(shot, depth=holes)
    yield from judge(fitted, "have no depth")
    yield reported("holes are said", "have no depth", fitted.messages)
    nothing = np.full_like(shot.depth, np.nan)
    yield refused("no depth at all", "depth", lambda: fit(shot, depth=nothing))
