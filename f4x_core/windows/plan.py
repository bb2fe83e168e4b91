"""The cut of a long clip into shots and overlapping windows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..clip.model import MIN_FRAMES
from ..errors import F4xError
from ..language.lexicon import plural

if TYPE_CHECKING:
    from ..fit.budget import ClipSize
    from ..fit.config import FitConfig

LONG = 360
"""Clips with more frames are fitted in windows by default; a phone films as many in twelve seconds. 200 and 300 frames fitted at
once show more from the side than in windows of 60, at a third of the Gaussians."""
LENGTHS = (LONG, 240, 120, 60)
"""Frames of a window, where nobody says it: the first of these that memory has room for."""
OVERLAP = 12
"""Frames that neighbouring windows share."""
MIN_OVERLAP = 2
"""Minimum overlap in frames; with less, a window cannot continue the motion of the one before."""

Window = tuple[int, int]
"""(first frame, end); the end is excluded."""


@dataclass(frozen=True)
class Shot:
    """The windows of one shot, in frames of the clip."""

    windows: tuple[Window, ...]
    """In order, each sharing frames with the next."""

    @property
    def start(self) -> int:
        """First frame."""
        return self.windows[0][0]

    @property
    def end(self) -> int:
        """Frame after the last one."""
        return self.windows[-1][1]


def usual_length(size: ClipSize, config: FitConfig, memory: float | None) -> int:
    """Return the default number of frames of a window for a clip of `size`; 0 for one that is fitted at once.

    `memory`: gigabytes that are granted, as in `fit.budget.Grant`.
    """
    from ..fit.budget import has_room  # loads torch, which a plan of many clips does without

    parts = {length: replace(size, frames=min(length, size.frames)) for length in LENGTHS}
    length = next((length for length, part in parts.items() if has_room(part, config, memory)), LENGTHS[-1])
    return 0 if size.frames <= length else length


def usual_overlap(length: int) -> int:
    """Return the default overlap of windows of `length` frames: `OVERLAP`, or less where that leaves none of their own."""
    return min(OVERLAP, (length - 1) // 2)


def plan_windows(start: int, end: int, length: int, overlap: int = OVERLAP) -> tuple[Window, ...]:
    """Cut the frames `start` to `end` into the fewest windows of at most `length` frames that share `overlap` with the next.

    All are equally long up to one frame: a short last one would be fitted worse than the others. Raises F4xError for
    lengths that leave a window no frame of its own.
    """
    if overlap < MIN_OVERLAP or length <= 2 * overlap:
        raise F4xError(
            f"windows of {length} {plural('frame', length)} cannot share {overlap}: let --overlap be {MIN_OVERLAP} or more and"
            " --window more than twice that."
        )
    count = max(1, math.ceil((end - start - overlap) / (length - overlap)))
    edges = start + np.round(np.linspace(0, end - start - overlap, count + 1)).astype(int)
    return tuple((int(a), int(b) + overlap) for a, b in pairwise(edges))


def plan_shots(count: int, cuts: Sequence[int], length: int, overlap: int = OVERLAP) -> tuple[Shot, ...]:
    """Return the windows of every shot of a clip of `count` frames that is cut before each of `cuts`.

    Shots too short for any fit are left out.
    """
    edges = [0, *cuts, count]
    shots = [(a, b) for a, b in pairwise(edges) if b - a >= MIN_FRAMES]
    return tuple(Shot(plan_windows(a, b, length, overlap)) for a, b in shots)
