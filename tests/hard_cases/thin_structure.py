"""A moving thing that is thinner than a pixel.

Hard: a bright wire, 0.9 pixels wide, moves by a pixel a frame.

Why: masks of so little are taken for specks, and flow does not see it.

Must hold: unseen frames are right, the wire too, or it is said that the scene stands still.
"""

from benchmarks.studies.hard_cases import limited, reported, that, within

from .common.film import Card, film, gliding, np, plain, room
from .common.fitting import fit, judge

STAGE, SLOW = "fit", True
RAYS = 4
"""Along either side of a pixel: one alone would miss the wire in one frame and widen it in another."""
MIN_PIXELS = 30
WIRE_ERROR = 0.5
"""Squared error where the wire is, in that of a picture without it."""


def check():
    wire = Card(plain(0.95, 0.95, 0.95), (0.004, 0.4), gliding((0.08, 0, 0.8), (-0.01, 0, 0)), moves=True)
    shot, without = film(room(wire), rays=RAYS), film(room(), rays=RAYS)
    unseen = np.flatnonzero(shot.clip.held_out)
    for t in unseen:
        yield that(
            f"the wire has {MIN_PIXELS} pixels or more in frame {t}, which is unseen", shot.mask[t].sum() >= MIN_PIXELS
        )
    fitted = fit(shot)
    yield from judge(fitted)
    shown, missed = 0.0, 0.0
    for t in unseen:
        true, place = shot.clip.frames[t] / 255, shot.mask[t]
        shown += np.square(fitted.picture(int(t)) - true)[place].sum()
        missed += np.square(without.clip.frames[t] / 255 - true)[place].sum()
    if shown <= WIRE_ERROR * missed:
        yield within("squared error where the wire is, in that of a picture without it", shown / missed, WIRE_ERROR)
    elif fitted.scene.scaffold is None:
        yield reported("the wire is not shown", "so the scene stands still", fitted.messages)
    else:
        yield limited(
            "the wire is not shown", True, "other places are taken to move, and it is not said that the wire is lost"
        )
