"""A zoom during the clip.

Hard: the camera stands still and its lens zooms in by half.

Why: a zoom looks like a step forward: a moving camera explains it by a flat world through a long lens, and that depth is nothing.

Must hold: unseen frames are right, the camera does not move, every frame has its own focal length, and the zoom is named.
"""

from benchmarks.studies.hard_cases import reported, that, within

from .common.film import FRAMES, LEVEL, film, mover, np, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True
FACTOR = 1.5


def check():
    shot = film(room(mover(0.02)), eye=LEVEL, look=LEVEL, focal=lambda time: 0.8 * FACTOR ** (time / (FRAMES - 1)))
    fitted = fit(shot)
    yield from judge(fitted)
    yield reported("the zoom is named", "lens zoomed during the clip", fitted.messages)
    yield that("the camera does not move", fitted.priors.camera_kind == "pan")
    focals = [path.intrinsics[:, 0, 0] for path in (fitted.scene.cameras, shot.cameras)]
    yield within(
        "focal lengths, relative to the first",
        np.abs(focals[0] / focals[1] / (focals[0] / focals[1])[0] - 1).max(),
        0.05,
    )
