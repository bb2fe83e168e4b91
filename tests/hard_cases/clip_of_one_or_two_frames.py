"""Clips of one and of two frames.

Hard: too little to tell motion from parallax.

Why: a fit runs to its end and shows nonsense from anywhere but the camera.

Must hold: refused before any work, with the number that is needed; three frames are fitted, and it is said they are few.
"""

from benchmarks.studies.hard_cases import refused, reported

from .common.film import film, mover, room
from .common.fitting import fit

STAGE, SLOW = "fit", True


def check():
    for frames in (1, 2):
        clip = film(room(mover()), frames=frames, hold_out=0)
        yield refused(
            f"{frames} frames", "too few to tell motion from parallax; give at least 3", lambda clip=clip: fit(clip)
        )
    fitted = fit(film(room(mover()), frames=3, hold_out=0))
    yield reported("three frames", "Only 3 frames were used", fitted.messages)
