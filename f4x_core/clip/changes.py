"""Where a clip breaks off and how its exposure changes: hard cuts and brightness, from small pictures. numpy alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

COLUMNS = 24
"""Cells across of the small pictures: what moves within a frame's time stays in its cell or the next."""
SHIFT = 2
"""Cells by which the picture may move from one frame to the next, in any direction."""
DIFFERENT = 0.72
"""Pictures whose cells correlate less than this, however shifted, show different things. Measured on six clips: neighbours
correlate by 0.87 or more, pictures of different places by 0.6 or less."""
FLAT = 2.0
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


def find_changes(frames: np.ndarray) -> Changes:
    """Return cuts and brightness of `frames (T, H, W, 3)` uint8.

    Small pictures of neighbouring frames are laid over each other, shifted as they fit best. A cut lies between t - 1 and t
    when neither t - 1 nor t - 2 looks like t or t + 1: correlation knows no exposure, and a flash or one spoilt frame is
    not a cut. Brightness is the median ratio of the cells.
    """
    small = [_cells(frame) for frame in frames]
    pairs = [_match(a, b) for a, b in pairwise(small)]
    alike = [likeness for likeness, _ in pairs]
    cuts = []
    for t in range(1, len(small)):
        if alike[t - 1] >= DIFFERENT:
            continue
        around = product(small[max(t - 2, 0) : t], small[t : t + 2])
        if max(_match(a, b)[0] for a, b in around) < DIFFERENT and not (cuts and t - cuts[-1] < 2):
            cuts.append(t)
    steps = np.array([0.0, *(step for _, step in pairs)])
    steps[cuts] = 0.0
    starts = np.zeros(len(small), np.int64)
    starts[cuts] = cuts
    total = np.cumsum(steps)
    return Changes(np.array(cuts, np.int64), np.exp(total - total[np.maximum.accumulate(starts)]))


def _cells(frame: np.ndarray) -> np.ndarray:
    """(h, w) float64 mean brightness (of 255) of square cells of a frame (H, W, 3); rims that fill no cell are left out."""
    height, width = frame.shape[:2]
    side = max(1, round(width / COLUMNS))
    rows, columns = max(1, height // side), width // side
    cut = frame[: rows * side, : columns * side]
    return cut.reshape(rows, -1, columns, side * 3).mean((1, 3), dtype=np.float64)


def _match(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Best correlation of two small pictures over all shifts, and the median log ratio of brightness b / a there."""
    best, ratio = -1.0, 0.0
    for down, right in product(range(-SHIFT, SHIFT + 1), repeat=2):
        one, other = _overlap(a, down, right), _overlap(b, -down, -right)
        if one.size < a.size / 2:
            continue
        likeness = _correlation(one, other)
        if likeness > best:
            best, ratio = likeness, float(np.median(np.log((other + DARK) / (one + DARK))))
    return best, ratio


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
