"""Flashes, fades and frozen frames.

Hard: single frames that are white, black or doubled, and a slow fade to black, without any cut.

Why: whatever compares neighbouring frames takes a flash for two cuts.

Must hold: no cut is found in them; a cut among them is.
"""

from benchmarks.studies.hard_cases import that
from f4x_core.clip.changes import find_changes

from .common.film import film, mover, np, room

STAGE = "clip"


def check():
    frames = film(room(mover(0.002)), frames=12).clip.frames
    flash, black, fade = frames.copy(), frames.copy(), frames.copy()
    flash[4], black[7] = 255, 0
    fade = (fade * np.linspace(1, 0.05, 12)[:, None, None, None]).astype(np.uint8)
    frozen = np.repeat(frames[:4], 3, 0)
    for name, clip in {"flash": flash, "black frame": black, "fade": fade, "frozen": frozen}.items():
        yield that(f"{name}: no cut", len(find_changes(clip).cuts) == 0)
    cut = np.concatenate([flash, frames[:5, ::-1, ::-1]])
    yield that("a cut after a flash", find_changes(cut).cuts.tolist() == [12])
    yield that("the fade is measured", find_changes(fade).exposure > 4)
