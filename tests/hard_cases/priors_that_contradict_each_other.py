"""Priors that contradict each other.

Hard: true cameras with a depth that is mirrored - far is near -, and a mask of the wrong place.

Why: every prior is believed by another stage; none can be right beside the others.

Must hold: everything stays finite, and it is said that the priors contradict each other.
"""

from .common.film import film, mover, room
from .common.fitting import fit, judge, np

STAGE, SLOW = "fit", True


def check():
    shot = film(room(mover()))
    depth = (np.nanmax(shot.depth) + np.nanmin(shot.depth) - shot.depth).astype(np.float32)
    fitted = fit(shot, cameras=shot.cameras, depth=depth, mask=shot.mask[:, :, ::-1].copy())
    yield from judge(fitted, "contradict each other")
