"""A clip of a thousand frames.

Hard: a mover that passes forty times, and a camera that goes to and fro; no memory should hold all of it at once.

Why: windows that forget what was there, drift apart or add to the background each time end in a blurred pile of scenes.

Must hold: the last pictures are as good as the first, seams as good as the rest, and the background is that of the first window.
"""

import tempfile
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from benchmarks.studies.hard_cases import that, within
from f4x_core.clip import Clip
from f4x_core.scene import read_scene
from f4x_core.windows.plan import plan_shots
from f4x_core.windows.shots import LongFit, evaluate_shot, fit_shot

from .common.film import film, mover, room
from .common.fitting import small

STAGE, SLOW, LONG = "fit", True, True
FRAMES, PASS, WINDOW = 1000, 26, 120
LOST_AT_SEAMS, LOST_AT_THE_END = 0.5, 1.0
"""dB."""
PASSES = 10
"""So many at either end are compared: single ones differ by up to 4 dB from one to the next, without a trend."""


def check():
    once = film(room(mover()), frames=PASS, hold_out=0).clip
    order = np.fromiter(islice(cycle([*range(PASS), *range(PASS - 2, 0, -1)]), FRAMES), int)

    def read(start: int, end: int) -> Clip:
        count = end - start
        times, held_out = np.arange(count, dtype=float), np.zeros(count, bool)
        picked = f"{start}:{end}:1"
        return replace(once, frames=once.frames[order[start:end]], times=times, held_out=held_out, picked=picked)

    (shot,) = plan_shots(FRAMES, [], WINDOW)
    with tempfile.TemporaryDirectory() as folder:
        scene = fit_shot(shot, LongFit(read, small()), Path(folder))
        first = read_scene(Path(folder) / "windows/000/scene.f4x")
        reported = evaluate_shot(scene, shot, read)
    psnr = np.array([row["psnr"] for row in reported["frames"]])
    yield that("there are a thousand cameras", len(scene.cameras) == FRAMES == len(psnr))
    yield within("dB lost at seams", max(reported["rest_psnr"] - reported["seam_psnr"], 0.0), LOST_AT_SEAMS)
    lost = max(psnr[: PASSES * PASS].mean() - psnr[-PASSES * PASS :].mean(), 0.0)
    yield within("dB lost from the first passes to the last", lost, LOST_AT_THE_END)
    yield within("background, in backgrounds of the first window", len(scene.static) / len(first.static), 1.5)
