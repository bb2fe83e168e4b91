"""Walks through furnished rooms.

Hard: floor, posts and boxes stand near the camera, and one or two things move before a wall that fills half of the picture.

Why: the wall alone looks like a turn on the spot; then what stands near it counts as moving, and the scene is a picture on a wall.

Must hold: cameras are found in every room, and most of what counts as moving moves.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

from benchmarks.studies.hard_cases import that, within
from f4x_core.evaluation.evaluate import path_error
from f4x_core.fit.config import profile
from f4x_core.priors.build import build_priors

from .common.rooms import furnished_room

STAGE, SLOW = "fit", True
ROOMS = range(8)
WRONG_PATH, WRONG_MASK = 0.05, 0.15
"""Most by which cameras may be off, in the path's length, and the largest fraction of the picture that is wrongly taken to move."""


def check():
    for number in ROOMS:
        shot = furnished_room(number)
        with tempfile.TemporaryDirectory() as folder:
            priors = build_priors(shot.clip, Path(folder), replace(profile("quick").priors, threads=1))
        yield that(f"room {number}: the camera moves", priors.camera_kind == "moving")
        ate = path_error(priors.cameras, shot.cameras)["ate_fraction"]
        yield within(f"room {number}: cameras, in the path's length", ate, WRONG_PATH)
        wrong = float((priors.mask & ~shot.mask).mean())
        yield within(f"room {number}: wrongly taken to move, fraction of the picture", wrong, WRONG_MASK)
