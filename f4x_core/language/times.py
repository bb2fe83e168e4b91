"""When: moments, durations and spans of a clip, in seconds, frames, time codes and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from .amounts import PLACES, number
from .grammar import either, lit, optional, table


@dataclass
class Clip:
    """What moments are counted in."""

    fps: float
    """Clip frames per second."""
    frames: int
    """Frames of the clip."""
    frame: float = 0.0
    """The present one."""


class TimeExpression(NamedTuple):
    """A sum of what a time can be counted in, as clip frame: frames + seconds x rate + last x last frame + now x present one."""

    frames: float = 0.0
    seconds: float = 0.0
    last: float = 0.0
    now: float = 0.0

    def plus(self, other: TimeExpression, sign: float = 1.0) -> TimeExpression:
        """This + sign x the other."""
        return TimeExpression(*(a + sign * b for a, b in zip(self, other, strict=True)))

    def resolve(self, context: Clip) -> float:
        """Clip frame, maybe outside the clip."""
        last = context.frames - 1
        return round(self.frames + self.seconds * context.fps + self.last * last + self.now * context.frame, PLACES)


START, END, NOW = TimeExpression(), TimeExpression(last=1.0), TimeExpression(now=1.0)


class Span(NamedTuple):
    """From … to."""

    start: TimeExpression
    end: TimeExpression | None
    """None: open."""
    kind: str = "range"
    """`moment`: only the start is given; `length`: only the length; `always`."""


_unit = table(
    {
        "second|seconds|sec|secs|s": TimeExpression(seconds=1.0),
        "frame|frames": TimeExpression(frames=1.0),
        "minute|minutes|min|mins": TimeExpression(seconds=60.0),
        "millisecond|milliseconds|ms": TimeExpression(seconds=0.001),
    }
)


def _times(x: float, unit: TimeExpression) -> TimeExpression:
    return TimeExpression().plus(unit, x)


duration = either(
    number + _unit >> _times,
    table({"half (a)|half of a": 0.5, "a quarter of a": 0.25, "a|an|one": 1.0, "a couple of|a couple": 2.0}) + _unit
    >> _times,
    lit("a|one") + _unit + lit("and a half") >> (lambda unit: _times(1.5, unit)),
)
_edge = table(
    {
        "the (very) [beginning|start] (of the clip|of the video|of the scene)|the start|start|beginning": START,
        "the (very) end (of the clip|of the video|of the scene)|end": END,
        "now|here|this [frame|moment|point]|the [present|current] [frame|moment]": NOW,
    }
)
_clock = number + lit(":") + number >> (lambda minutes, seconds: TimeExpression(seconds=60 * minutes + seconds))
_counted = ~lit("the") + _unit + ~lit("number|no|#") + number >> (lambda unit, x: _times(x, unit))
_measured = number + _unit + ~lit("in|into (the) [clip|video|scene]|mark") >> _times
_fraction_moment = table({"half a": 0.5, "one": 1.0}) + _unit >> _times
moment = either(_edge, _counted, _measured, _fraction_moment, _clock)
_to = lit("to|-|until|up to|through|and|thru")
_pair = either(
    moment + _to + moment >> (lambda a, b: (a, b)),
    ~lit("the") + _unit + number + _to + number >> (lambda unit, a, b: (_times(a, unit), _times(b, unit))),
    number + _to + number + _unit >> (lambda a, b, unit: (_times(a, unit), _times(b, unit))),
)
_pair_between = lit("between") + _pair
_pair_from = ~lit("from|in|during|for|over|within|at|starting [at|from|in]|beginning [at|from]|on") + _pair
_length = either(duration, optional(number, 1.0) + _unit >> _times)
_first = ~lit("for|in|during|over|within|throughout|on|at") + lit("the first") + _length
_last = ~lit("for|in|during|over|within|throughout|on|at") + lit("the [last|final]") + _length
_onward = ~lit("on|onward|forward|and on|and onward|on out")
_since = lit(
    "from|after|since|as of|starting|starting [at|from|in|with|on]|beginning [at|from|in|with]|start at|at|in|on|"
    "once we reach|when we reach"
)
_begin = _since + moment + _onward
_for = lit("for|lasting") + duration


def _lasting(start: TimeExpression, length: TimeExpression) -> Span:
    return Span(start, start.plus(length))


_comma = ~lit(",")
span = either(
    (_pair_from | _pair_between) >> (lambda pair: Span(*pair)),
    _for + _comma + _begin >> (lambda length, start: _lasting(start, length)),
    _begin + _comma + _for >> _lasting,
    _first >> (lambda length: Span(START, length)),
    _last >> (lambda length: Span(END.plus(length, -1.0), None)),
    lit("until|before|up to|up until") + moment >> (lambda end: Span(START, end)),
    _begin >> (lambda start: Span(start, None, "moment")),
    _for >> (lambda length: Span(NOW, NOW.plus(length), "length")),
    table(
        {
            "always|all the time|the whole time|[for|during|throughout|over] the [whole|entire] [clip|video|time]|"
            "throughout|forever": Span(START, None, "always")
        }
    ),
)
"""A `Span`."""
