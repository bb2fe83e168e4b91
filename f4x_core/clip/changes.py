"""Where a clip breaks off and how its exposure changes: hard cuts and brightness, from small pictures. numpy alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

COLUMNS = 48
"""Cells across of the small pictures."""
SHIFT = 4
"""Cells by which the picture may move from one frame to the next, in any direction."""
DIFFERENT = 0.7
"""Pictures whose cells correlate less than this, however shifted, show different things. Measured on six clips: neighbours
correlate by 0.95 or more, pictures of different places by 0.66 or less."""
STANDS_OUT = 3.0
"""A cut is so many times less alike than the frames around it are: what crosses the picture fast is no cut."""
AROUND = 2
"""Frames on either side of a cut that it must stand out from."""
FLAT = 0.5
"""Standard deviation of the cells (of 255) below which a picture shows nothing to compare."""
DARK = 4.0
"""Brightness (of 255) added before a ratio is taken, so that black cells say nothing."""


@dataclass(frozen=True, eq=False)
class Changes:
    """What changes all at once in a clip of T frames."""

    cuts: np.ndarray
    """(C,) int64 first frames of the shots after the first."""
    gain: np.ndarray
    """(T,) float64 brightness relative to the first frame of the shot, of the same things in both."""

    @property
    def exposure(self) -> float:
        """Brightest over darkest `gain` within one shot, at least 1."""
        shots = np.split(self.gain, self.cuts)
        return max(float(shot.max() / shot.min()) for shot in shots)


def find_changes(frames: Iterable[np.ndarray]) -> Changes:
    """Return cuts and brightness of `frames (T, H, W, 3)` uint8, or of frames that come one at a time.

    Small pictures of neighbouring frames are laid over each other, shifted as they fit best. A cut lies between t - 1 and t
    when neither t - 1 nor t - 2 looks like t or t + 1, and the frames around are more alike: correlation knows no exposure,
    and a flash or one spoilt frame is not a cut. Brightness is the median ratio of the cells.
    """
    small = [_cells(frame) for frame in frames]
    pairs = [_match(a, b) for a, b in pairwise(small)]
    unlike = 1 - np.array([1.0, *(likeness for likeness, _ in pairs)])  # [t] = t - 1 against t
    cuts: list[int] = []
    for t in np.flatnonzero(unlike > 1 - DIFFERENT).tolist():
        beside = np.concatenate([unlike[max(t - AROUND, 1) : t], unlike[t + 1 : t + 1 + AROUND]])
        across = product(small[max(t - 2, 0) : t], small[t : t + 2])
        if (
            unlike[t] > STANDS_OUT * np.median(beside if len(beside) else [0.0])
            and max(_match(a, b)[0] for a, b in across) < DIFFERENT
        ):
            cuts.append(t)
    steps = np.array([0.0, *(step for _, step in pairs)])
    steps[cuts] = 0.0
    starts = np.zeros(len(small), np.int64)
    starts[cuts] = cuts
    total = np.cumsum(steps)
    return Changes(np.array(cuts, np.int64), np.exp(total - total[np.maximum.accumulate(starts)]))


def _cells(frame: np.ndarray) -> np.ndarray:
    """(h, w) float64 mean brightness (of 255) of square cells of a frame (H, W, 3), softened so that half a cell of motion
    does not matter; rims that fill no cell are left out."""
    height, width = frame.shape[:2]
    side = max(1, round(width / COLUMNS))
    rows, columns = max(1, height // side), width // side
    kept = frame[: rows * side, : columns * side]
    cells = np.pad(kept.reshape(rows, -1, columns, side * 3).mean((1, 3), dtype=np.float64), 1, mode="edge")
    cells = (cells[:-2] + 2 * cells[1:-1] + cells[2:]) / 4
    return (cells[:, :-2] + 2 * cells[:, 1:-1] + cells[:, 2:]) / 4


def _match(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Best correlation of two small pictures over all shifts, and the median log ratio of brightness b / a there."""
    tried: dict[tuple[int, int], float] = {}
    best, reach = (0, 0), range(-SHIFT, SHIFT + 1, 2)
    for places in (product(reach, repeat=2), product((-1, 0, 1), repeat=2)):  # every second one, then around the best
        for down, right in [(best[0] + y, best[1] + x) for y, x in places]:
            one, other = _overlap(a, down, right), _overlap(b, -down, -right)
            if one.size >= a.size / 2:
                tried[down, right] = _correlation(one, other)
        best = max(tried, key=lambda shift: tried[shift])
    one, other = _overlap(a, *best), _overlap(b, -best[0], -best[1])
    return tried[best], float(np.median(np.log((other + DARK) / (one + DARK))))


def _overlap(picture: np.ndarray, down: int, right: int) -> np.ndarray:
    """The part of a picture that another one, shifted by so many cells, covers."""
    rows, columns = picture.shape
    return picture[max(down, 0) : rows + min(down, 0), max(right, 0) : columns + min(right, 0)]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Normalised correlation; two flat pictures are alike, a flat one and another are not."""
    a, b = a - a.mean(), b - b.mean()
    flat = a.std() < FLAT, b.std() < FLAT
    if any(flat):
        return float(all(flat))
    return float((a * b).mean() / (a.std() * b.std()))
