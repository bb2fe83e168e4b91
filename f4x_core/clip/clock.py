"""When the frames of a clip were taken, in clip frames: the unit of every time that later stages know."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RATE_TOLERANCE = 0.01
"""Relative; where the file's own frame rate is off by more, its time stamps are believed: a file cut short keeps the rate of the
whole, and some formats only guess one."""
STEADY = 0.01
"""Frames by which time stamps may be off a constant rate, besides their rounding."""
ROUNDING = 0.3
"""Frames that rounding is taken for at most: a coarse clock still tells where a frame is missing."""
GRID = 1024
"""Times are whole multiples of a frame's 1024th, so that sums and differences of them are exact: windows share them."""


class Shown(NamedTuple):
    """One picture of a film and when it is shown."""

    pixels: np.ndarray
    """(H, W, 3) uint8 sRGB."""
    seconds: float
    """Its time stamp; NaN where the file has none."""
    tick: float
    """Seconds to which time stamps are rounded."""


class Clock(NamedTuple):
    """The times of a clip's frames."""

    times: np.ndarray
    """(T,) float64 clip frames from 0 to T-1, exactly 0, 1, 2, ... at a constant rate."""
    fps: float
    """Clip frames per second."""


def read_clock(seconds: Sequence[float] | np.ndarray, tick: float, rate: float) -> Clock:
    """Return the clock of frames shown at `seconds (T,)`, rounded to `tick` seconds, of a file that says `rate` frames per second.

    The unit is the mean interval. Frames without time stamps, or with such that do not increase, are taken for evenly spaced.
    """
    count = len(seconds)
    even = np.arange(count, dtype=np.float64)
    stamps = np.asarray(seconds, np.float64)
    if count < 2 or not (np.diff(stamps) > 0).all():
        return Clock(even, rate)
    interval = float(stamps[-1] - stamps[0]) / (count - 1)
    times = np.round((stamps - stamps[0]) / interval * GRID) / GRID
    if np.abs(times - even).max() > STEADY + min(tick / interval, ROUNDING):
        if (np.diff(times) > 0).all():
            return Clock(times, 1 / interval)
        return Clock(even, 1 / interval)
    return Clock(even, rate if abs(rate * interval - 1) < RATE_TOLERANCE else 1 / interval)
