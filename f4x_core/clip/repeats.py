"""Frames that repeat the one before: 24 frames a second written as 30, every frame twice, a varying rate made constant.

A camera that seems to stop every few frames looks bumped, and moving objects seem to stutter.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from .clock import Shown
from .notes import Note

SAME = 3.0
"""Mean difference (of 255 levels) between a frame and its repeat at most: compression refines a repeat a little."""
FRACTION = 1 / 6
"""A repeat differs less than this fraction of the difference of the frames around it. Measured at six codecs and rates: repeats
have at most 0.12; neighbouring frames of twelve clips have at least 0.56 of their neighbours' difference."""
MAX_REPEATS = 5
"""Maximum repeats of a frame, as of 10 frames a second shown at 60. A longer standstill was filmed so, and is kept."""


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean absolute difference of two pictures (H,W,3) uint8 in levels; infinite where their sizes differ."""
    import cv2

    return sum(cv2.mean(cv2.absdiff(a, b))[:3]) / 3 if a.shape == b.shape else np.inf


@dataclass
class _Run:
    """A frame that is kept, and those after it that may repeat it."""

    kept: np.ndarray
    step: float = np.inf
    """Difference of `kept` from the frame before it; infinite where there is none."""
    waiting: list[Shown] = field(default_factory=list)
    most: float = 0.0
    """Largest difference of `waiting` from `kept`."""
    still: bool = False
    """More frames look like `kept` than a film repeats one."""


def without_repeats(frames: Iterable[Shown], notes: list[Note]) -> Iterator[Shown]:
    """Yield `frames` but for those that repeat the one before; says so in `notes`.

    A frame counts as a repeat where the picture moves before and after: a picture at rest is no repeat. At most `MAX_REPEATS`
    frames wait for the one after them.
    """
    run: _Run | None = None
    repeated = False
    for shown in frames:
        if run is None:
            run = _Run(shown.pixels)
            yield shown
            continue
        step = difference(run.kept, shown.pixels)
        if step <= min(SAME, FRACTION * run.step):
            run.waiting.append(shown)
            run.most = max(run.most, step)
            run.still = run.still or len(run.waiting) > MAX_REPEATS
            if run.still:
                yield from run.waiting
                run.waiting.clear()
            continue
        if run.waiting and run.most <= FRACTION * step:
            repeated = True
            notes += (Note("repeated", one.number, one.seconds) for one in run.waiting)
        else:
            yield from run.waiting
        run = _Run(shown.pixels, step)
        yield shown
    if run is not None and repeated and run.waiting:
        notes += (Note("repeated", one.number, one.seconds) for one in run.waiting)
    elif run is not None:
        yield from run.waiting
