"""Time maps of retiming operations, from the clip frame shown to the clip frame read, and how complete a change is at a time."""

from __future__ import annotations

import math
from collections.abc import Callable

from .operations import (
    Blur,
    Delete,
    Duplicate,
    Ease,
    Extract,
    Freeze,
    Grade,
    Loop,
    Match,
    Opacity,
    Operation,
    Recolour,
    Retime,
    Reverse,
    Span,
    Style,
)

AppearanceChange = Recolour | Opacity | Delete | Extract | Style | Match | Grade | Blur
"""Operations that change appearance; the others change placement or timing."""
TimeMap = Callable[[float], float]
"""Clip frame shown -> clip frame read."""


SOFT = 0.25
"""Fraction of a span that each of its soft ends takes, or less where it is slow."""


def holds(frames: Span | None, time: float) -> bool:
    """Whether `time` lies within `frames`, both ends included."""
    return frames is None or frames[0] <= time <= (math.inf if frames[1] is None else frames[1])


def progress(frames: Span | None, ease: Ease, time: float, last: float) -> float:
    """Completed fraction of a transform at `time`, 0 to 1; a span without an end goes to `last`, the clip's last frame."""
    if frames is None:
        return 1.0
    first, end = frames[0], max(last if frames[1] is None else frames[1], frames[0])
    if ease == "step" or first == end:
        return float(time >= first)
    fraction = min(max((time - first) / (end - first), 0.0), 1.0)
    return fraction * fraction * (3 - 2 * fraction) if ease == "smooth" else fraction


def effect(operation: AppearanceChange, time: float, last: float) -> float:
    """Completed fraction of a change of appearance at `time`, 0 to 1."""
    ease: Ease | None = getattr(operation, "ease", None)
    if ease is not None:
        fraction = progress(operation.frames, ease, time, last)
        return 1 - fraction if isinstance(operation, Opacity) and operation.inward else fraction
    return float(holds(operation.frames, time))


def time_map_of(operation: Operation, clip: tuple[float, float]) -> TimeMap | None:
    """The time map of a retiming operation, None of any other; `clip` is its first and last frame."""
    if isinstance(operation, Freeze):
        return _freeze(operation)
    if isinstance(operation, Retime):
        return _retime(operation, clip)
    if isinstance(operation, Reverse):
        return _reverse(operation, clip)
    return _loop(operation) if isinstance(operation, Loop) else None


def copy_time_map(operation: Duplicate, copy: int, clip: tuple[float, float]) -> TimeMap:
    """The time map of copy number `copy` (from 1): delayed by its shift, clamped to the clip."""
    shift, (first, last) = copy * operation.time_shift, clip
    return (lambda time: min(max(time - shift, first), last)) if shift else (lambda time: time)


def _freeze(operation: Freeze) -> TimeMap:
    at, end = operation.at, math.inf if operation.until is None else operation.until
    return lambda time: time if time <= at else at if time <= end else time - (end - at)


def _retime(operation: Retime, clip: tuple[float, float]) -> TimeMap:
    (first, last), speed = clip, operation.speed
    begin, end = operation.frames or (first, None)
    stop = math.inf if end is None else end

    def eased(time: float) -> float:
        length = (last if end is None else end) - begin
        if time <= begin or length <= 0:
            return time if time <= begin else min(begin + speed * (time - begin), last)
        u = min((time - begin) / length, 1.0)
        after = max(time - begin - length, 0.0) * (1 if operation.ease == "soft" else speed)
        return min(begin + length * (u + (speed - 1) * _changed(operation, u)) + after, last)

    def time_map(time: float) -> float:
        if time <= begin:
            return time
        return min(begin + speed * (min(time, stop) - begin) + max(time - stop, 0.0), last)

    return eased if operation.ease else time_map


def _changed(operation: Retime, u: float) -> float:
    """The integral of an ease from 0 to `u`, fractions of its span; of a soft one it is 1 at the end."""
    if operation.ease != "soft":
        return u * u / 2 if operation.ease == "linear" else u**3 - u**4 / 2
    side = min(operation.speed / 2, SOFT)  # so short that it never runs backwards between the ends
    rise, fall = ((min(x, side) ** 2 / 2 / side + max(x - side, 0)) for x in (u, max(u - 1 + side, 0)))
    return (rise - fall) / (1 - side)


def _reverse(operation: Reverse, clip: tuple[float, float]) -> TimeMap:
    begin, end = operation.frames or clip
    end = clip[1] if end is None else end
    # At the clip's end it goes on backwards, as every motion there goes on.
    until = math.inf if end >= clip[1] else end
    since = -math.inf if begin <= clip[0] else begin
    return lambda time: begin + end - time if since <= time <= until else time


def _loop(operation: Loop) -> TimeMap:
    begin, end = operation.frames
    if end is None:
        return lambda time: time
    # Every frame of the part is shown once in a round, the last one too.
    return lambda time: time if time <= end else min(begin + (time - begin) % (end - begin + 1), end)
