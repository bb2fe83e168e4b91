"""Times of the frames of a clip, in clip frames: the unit of every time that later stages know."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .notes import Note, gaps

DEFAULT_FPS = 24.0
"""Frames a second of folders and films that do not tell; also the rate of DAVIS."""
RATE_TOLERANCE = 0.01
"""Relative; where the file's own frame rate is off by more, its time stamps are believed: a file cut short keeps the rate of the
whole, and some formats only guess one."""
STEADY = 0.01
"""Frames by which time stamps may be off a constant rate, besides their rounding."""
ROUNDING = 0.3
"""Frames that rounding is taken for at most: a coarse clock still tells where a frame is missing."""
HOLD = 16
"""Frames by which the order of decoding may differ from that of presentation; H.264 and HEVC allow no more."""
MENDED = 0.1
"""Fraction of the time stamps that may be out of order; where more are, none is believed."""
MIN_CYCLES = 3
"""Frames shown longer than the others, at regular distances, from which a slower rate is told from frames that are missing."""
LONGEST = 100
"""Times the usual interval that a pause is taken for at most, where its own length leaves no times for the other frames."""
GRID = 1024
"""Times are whole multiples of a frame's 1024th, so that sums and differences of them are exact: windows share them."""


class Shown(NamedTuple):
    """Picture of a source, with its time."""

    pixels: np.ndarray
    """(H, W, 3) uint8 sRGB."""
    seconds: float
    """Time stamp; NaN where the file has none."""
    tick: float
    """Seconds to which time stamps are rounded."""
    number: int = 0
    """Index among all frames of the source, those that are left out included."""
    alpha: np.ndarray | None = None
    """(H, W) uint8, 0 where the picture hides its colours; None where it hides nothing."""


class Clock(NamedTuple):
    """The times of a clip's frames."""

    times: np.ndarray
    """(T,) float64 clip frames from 0 to T-1, exactly 0, 1, 2, ... at a constant rate."""
    fps: float
    """Clip frames per second."""
    notes: tuple[Note, ...] = ()
    """Time stamps that were not believed, by clip frame, and long gaps."""


def read_clock(seconds: Sequence[float] | np.ndarray, tick: float, rate: float, slower: float = 0.0) -> Clock:
    """Return the clock of frames shown at `seconds (T,)`, rounded to `tick` seconds, of a file that says `rate` frames per second.

    The unit is the mean interval. A few stamps out of order are put between their neighbours; frames without stamps, or with
    many out of order, are taken for evenly spaced. `slower`: the constant rate that frames stand for whose repeats were left
    out (`rate_without_repeats`); 0: none is known.
    """
    count = len(seconds)
    even = np.arange(count, dtype=np.float64)
    given = np.asarray(seconds, np.float64)
    if count < 2 or not np.isfinite(given).all():
        return Clock(even, rate)
    stamps = _mended(given)
    if stamps is None:
        return Clock(even, rate, (Note("unordered", 0),))
    mended = np.flatnonzero(~np.isin(stamps, given))
    notes = tuple(Note("stamp", int(frame), stamps[frame]) for frame in mended)
    interval = float(stamps[-1] - stamps[0]) / (count - 1)
    if slower:
        return Clock(even, slower, notes)
    times = np.round((stamps - stamps[0]) / interval * GRID) / GRID
    if not (np.diff(times) > 0).all():  # a pause so long that the frames around it have no times of their own
        steps = np.diff(stamps)
        short = np.append(0, np.cumsum(np.minimum(steps, LONGEST * np.median(steps))))
        interval = float(short[-1]) / (count - 1)
        times = np.round(short / interval * GRID) / GRID
    if np.abs(times - even).max() > STEADY + min(tick / interval, ROUNDING):
        if (np.diff(times) > 0).all():
            return Clock(times, 1 / interval, (*notes, *gaps(stamps, 1.0)))
        return Clock(even, 1 / interval, notes)
    return Clock(even, rate if abs(rate * interval - 1) < RATE_TOLERANCE else 1 / interval, notes)


def _mended(stamps: np.ndarray) -> np.ndarray | None:
    """Return `stamps (T,)` with the few that are out of order put evenly between their neighbours; None where too many are.

    Of two stamps in the wrong order either may be the wrong one: it is that which leaves the more even intervals. Some files
    have the times of decoding, which are the right ones in another order.
    """
    mended, wrong, most = stamps.copy(), 0, max(1, MENDED * len(stamps))
    while (late := np.flatnonzero(np.diff(mended) <= 0)).size:
        if wrong + 1 > most:
            order = np.argsort(stamps, kind="stable")
            near = np.abs(order - np.arange(len(order))).max() <= HOLD
            return stamps[order] if near and (np.diff(stamps[order]) > 0).all() else None
        first = int(late[0])
        spans = [[first], [first + 1]]
        if first + 2 < len(stamps) - 1 and wrong + 2 <= most:
            spans.append([first + 1, first + 2])
        tries = [(_without(mended, span), span) for span in spans]
        mended, span = min(tries, key=lambda one: _unevenness(*one))
        wrong += len(span)
    return mended


def _unevenness(stamps: np.ndarray, span: list[int]) -> tuple[int, float]:
    """Return the unevenness of `stamps`; those of `span` were put between neighbours and have to gain twice as much."""
    return int((np.diff(stamps) <= 0).sum()), float(np.abs(np.diff(stamps, 2)).sum()) * len(span)


def _without(stamps: np.ndarray, span: list[int]) -> np.ndarray:
    """Return `stamps` with those of the frames `span` replaced by times between, or beyond, their neighbours."""
    others = np.delete(np.arange(len(stamps)), span)
    new = stamps.copy()
    if span[0] > 0 and span[-1] < len(stamps) - 1:
        new[span] = np.interp(span, others, stamps[others])
    else:
        beside, next_to_it = others[:2] if span[0] == 0 else others[:-3:-1]
        new[span] = 2 * stamps[beside] - stamps[next_to_it]
    return new


def rate_without_repeats(seconds: Sequence[float] | np.ndarray, rate: float) -> float:
    """Return the constant rate whose frames a source of `rate` first shows at `seconds (T,)`, each at least once; 0: none.

    24 frames a second shown as 30 are such: every fourth is shown twice.
    """
    if len(seconds) < 3 or not np.isfinite(seconds).all():
        return 0.0
    shown = np.round((np.asarray(seconds) - seconds[0]) * rate)
    steps = np.diff(shown)
    longer = np.flatnonzero(steps > steps.min())
    each = steps.min()
    if longer.size:
        if longer.size < MIN_CYCLES or np.ptp(np.diff(longer)) > 1:
            return 0.0
        each = (shown[longer[-1]] - shown[longer[0]]) / (longer[-1] - longer[0])
    off = shown - each * np.arange(len(shown))
    return rate / float(each) if each > 0 and np.ptp(off) < 1 + STEADY else 0.0
