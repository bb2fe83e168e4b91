"""A tripod that is bumped.

Hard: the camera rests but for one frame, in which the picture is five pixels off.

Why: one frame alone decides whether the camera moves, and the path is not smooth.

Must hold: unseen frames are right, and the bump is named with its frames.
"""

from benchmarks.studies.hard_cases import reported

from .common.film import LEVEL, film, mover, np, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True
BUMP = 11
"""The frame."""


def check():
    shot = film(
        room(mover(0.01)),
        eye=LEVEL,
        look=lambda time: np.array([0.03, 0.05, 0]) * (round(time) == BUMP),
        frames=18,
        hold_out=8,
    )
    fitted = fit(shot)
    yield from judge(fitted)
    yield reported("the bump is named", f"bumped between frames {BUMP} and {BUMP + 1}", fitted.messages)
