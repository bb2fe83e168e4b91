"""When: moments, durations and spans of a clip, in seconds, frames, time codes and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from .amounts import fraction, number, percent
from .grammar import either, here, keyword, literal, optional, table, unless
from .lexicon import FRACTIONS, ORDINALS, PICTURE, PLACES


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
    """A sum of what a time can be counted in, as clip frame: frames + seconds x rate + last x last frame + now x present one
    + clip x number of frames."""

    frames: float = 0.0
    seconds: float = 0.0
    last: float = 0.0
    now: float = 0.0
    clip: float = 0.0

    def plus(self, other: TimeExpression, sign: float = 1.0) -> TimeExpression:
        """This + sign x the other."""
        return TimeExpression(*(a + sign * b for a, b in zip(self, other, strict=True)))

    def resolve(self, context: Clip) -> float:
        """Clip frame, maybe outside the clip."""
        last = context.frames - 1
        counted = self.frames + self.seconds * context.fps + self.last * last + self.now * context.frame
        return round(counted + self.clip * context.frames, PLACES)


START, END, NOW = TimeExpression(), TimeExpression(last=1.0), TimeExpression(now=1.0)
HALF_WAY = TimeExpression(clip=0.5)


def no_such_time(time: TimeExpression, clip: Clip) -> str:
    """The sentence about a time that the clip does not have, in the unit that it was given in."""
    frame = time.resolve(clip)
    unit, value = ("second", frame / clip.fps) if time.seconds else ("frame", frame)
    lasts = f"{clip.frames / clip.fps:.2f} seconds, frames 0 to {clip.frames - 1}"
    return f"There is no {unit} {round(value, 2):g}: the clip lasts {lasts}."


class Span(NamedTuple):
    """From … to."""

    start: TimeExpression
    end: TimeExpression | None
    """None: open."""
    kind: str = "range"
    """`moment`, `from`: only the start is given, at or since which it is; `by`: only when it is done; `length`: only the length;
    `in`: after so long, or for so long; `always`."""


_unit = table(
    {
        "second|seconds|sec|secs|s|second mark": TimeExpression(seconds=1.0),
        "frame|frames|f|fr|frm|frms": TimeExpression(frames=1.0),
        "minute|minutes|min|mins": TimeExpression(seconds=60.0),
        "msec|millisecond|milliseconds|ms": TimeExpression(seconds=0.001),
    }
)


def _times(x: float, unit: TimeExpression) -> TimeExpression:
    return TimeExpression().plus(unit, x)


duration = either(
    number + _unit >> _times,
    table({"half (a)": 0.5, "(a) quarter (of) (a)": 0.25, "[a|one] (full|whole)|an": 1.0}) + _unit >> _times,
    ~keyword("a|one") + _unit + keyword("and") + fraction >> (lambda unit, part: _times(1 + part, unit)),
)
_edge = table(
    {
        f"the (very) [beginning|start|first frame|outset|head|opening] (of the [{PICTURE}])|start|beginning": START,
        f"the (very) [end|last frame|finish|tail|close] (of the [{PICTURE}])|end": END,
        "now|here|this [frame|moment|point]|the [present|current] [frame|moment]": NOW,
    }
)
_clock = either(
    number + keyword(":") + number + keyword(":") + number + keyword(":") + number
    >> (lambda h, m, s, f: TimeExpression(frames=f, seconds=3600 * h + 60 * m + s)),
    number + keyword(":") + number + keyword(":") + number
    >> (lambda h, m, s: TimeExpression(seconds=3600 * h + 60 * m + s)),
    number + keyword(":") + number + ~keyword("minutes") >> (lambda m, s: TimeExpression(seconds=60 * m + s)),
)
_through = keyword("(of the way) [through|in|into|along]|of the way") + ~keyword(f"the (whole) [{PICTURE}]|it")
_of_it = keyword(f"of the [{PICTURE}]|of it")
_share = table({**FRACTIONS, "two thirds": 2 / 3, "three quarters": 0.75}) + ~_of_it
_middle_point = keyword(f"the middle (of the [{PICTURE}])|halfway|half way") >> (lambda: HALF_WAY)
_part_way = either(
    keyword("halfway|half way|midway|mid way")
    + unless(keyword("around|round"))
    + ~(_through | keyword("point") + ~keyword(f"of the [{PICTURE}]"))
    >> (lambda: HALF_WAY),
    keyword(f"the (very) middle of the [{PICTURE}]|(the) [midpoint|mid point]|the [halfway|half way|half] [point|mark]")
    >> (lambda: HALF_WAY),
    fraction + (_through | _of_it | keyword("of the time|through the time|in")) >> (lambda x: TimeExpression(clip=x)),
    percent + (_through | keyword(f"of the [{PICTURE}]")) >> (lambda x: TimeExpression(clip=x)),
)
"""Moments that are told by how much of the clip is over."""
_counted = ~keyword("the") + _unit + ~keyword("number|no|#") + number >> (lambda unit, x: _times(x, unit))
_frame_number = keyword("[frame|f|fr] (number|no|#)") + number >> (lambda x: TimeExpression(frames=x))
_measured = either(
    literal("t (=)|time =") + number + ~keyword("s|sec") >> (lambda x: TimeExpression(seconds=x)),
    ~keyword("the") + number + _unit + ~keyword(f"in|into (the) [{PICTURE}]|into it|mark|point") >> _times,
    table({"half a": 0.5, "one|a": 1.0}) + _unit >> _times,
)
_numbered = ~keyword("the") + number + keyword("(th|st|nd|rd|the) frame|th|st|nd|rd") >> (
    lambda x: TimeExpression(frames=x)
)
_nth = table({f"the {word} second": float(n) for n, word in enumerate(ORDINALS)})
_hedge = ~literal(
    "like|say|maybe|about|around|roughly|approximately|circa|exactly|precisely|right|just|shortly|some|somewhere around"
)
_before_end = duration + keyword(f"before (the) end (of the [{PICTURE}])|from the end (of the [{PICTURE}])") >> (
    lambda length: END.plus(length, -1.0)
)
moment = ~literal("(the) [timecode|time code|timestamp|time|tc|mark]") + either(
    _edge, _numbered, _counted, _before_end, _measured, _clock, _part_way
)
_to = keyword("(right|through|all the way|on|up) [to|until|up to|up until]|-|through|and")
_pair = either(
    moment + _to + (moment | _middle_point) >> Span,
    ~keyword("the") + _unit + number + _to + number >> (lambda unit, a, b: Span(_times(a, unit), _times(b, unit))),
    number + _to + number + _unit >> (lambda a, b, unit: Span(_times(a, unit), _times(b, unit))),
    number + _unit + _to + number >> (lambda a, unit, b: Span(_times(a, unit), _times(b, unit))),
)
_length = either(duration, optional(number, 1.0) + _unit >> _times)
_over = ~keyword("[for|in|during|over|within|throughout|on|at|across] (only|just)|[over|in] the course of")
_first = _over + keyword("(the) (very) [first|opening|initial|starting]") + _length + ~_of_it
_last = _over + keyword("(the) (very) [last|final|closing]") + _length + ~_of_it
_TO_THE_END = "[until|to|through to|through|up until] the (very) end|all the way to the end"
_goes_on = keyword(
    f"(and) [on|onward|forward|after|beyond|later|up]|or later|(right) [{_TO_THE_END}]|for good|for the [rest|remainder] "
    f"(of the [{PICTURE}]|of it)"
)
_FRAMES = "[every|all|any|each] (the|of the) [frame|frames|time|second|seconds]|(for) everything"
_since = keyword(
    "(right) from|after|since|as of|as from|once|not before|[no|not] [earlier|sooner] than|([in|on|for]) "
    f"({_FRAMES}) [after|from|past|since]|starting ([at|from|in|with|on])|beginning ([at|from|in|with])|start at"
)
_until = keyword(
    f"until|before|(right|all the way) [up to|up until]|[no|not] later than|ending [at|with|on|in]|({_FRAMES}) [before|until]"
)
_reaches = "[we|it|you] [reach|hit|get to|are at|is at]|the [clip|video|clock|timer|time] [reaches|hits|shows]"
_at = keyword("at|@|in|on|around|about|near|when|as soon as") | keyword("once|when|as soon as") + keyword(_reaches)
_passed = keyword("[is|are] [over|up|through|done]|[has|have] [passed|gone by|elapsed]|[passes|elapses]")
_since_then = either(
    _since + _hedge + (moment | _middle_point) + ~_goes_on,
    keyword("after|past|once|when")
    + (keyword("the first") + _share | _share + keyword("(of) the (whole) [" + PICTURE + "|time]") + ~_passed)
    >> (lambda x: TimeExpression(clip=x)),
    _since + keyword("the (very) [first|opening]") + _length + ~_goes_on >> START.plus,
    (_measured | _counted) + _goes_on,
)
_just_then = (
    unless(keyword("in here"))
    + either(
        _at
        + _hedge
        + (moment | here(lambda reading, at: reading.word(at - 1) in ("around", "about", "near")) + _middle_point)
        + ~keyword("exactly|precisely|sharp|or so"),
        _hedge
        + either(
            duration + keyword(f"in|into (the) [{PICTURE}]|into it|in the [{PICTURE}]"),
            _part_way,
            _before_end,
            _frame_number,
        ),
    )
    + ~_goes_on
)
_begin = _since_then | _just_then
_for = keyword("for|lasting|over|within|during|over the course of|over a period of|taking|spanning") + _hedge + duration
_during = ~keyword("for|in|during|over|within|throughout|across")
_comma = ~keyword(",")


def _lasting(start: TimeExpression, length: TimeExpression) -> Span:
    return Span(END.plus(length, -1.0), None) if start == END else Span(start, start.plus(length))


def _about_middle(length: TimeExpression) -> Span:
    return Span(HALF_WAY.plus(length, -0.5), HALF_WAY.plus(length, 0.5))


def _only_then(start: TimeExpression) -> Span:
    return Span(start, None, "moment") if start in (START, END) else Span(start, start)


span = either(
    ~keyword("from|since|in|during|for|over|within|across|at|between|starting [at|from|in]|beginning [at|from|in]|on")
    + _pair,
    _for + _comma + ~keyword("starting|beginning") + _begin >> (lambda length, start: _lasting(start, length)),
    _begin + _comma + _for >> _lasting,
    _begin
    + _comma
    + keyword("(and) [(right|all the way) [until|up to|up until]|[no|not] later than|ending [at|with|on|in]]")
    + _hedge
    + (moment | _middle_point)
    >> Span,
    _during + keyword("the [middle|central]") + (_share >> (lambda x: TimeExpression(clip=x)) | _length)
    >> _about_middle,
    _first >> (lambda length: Span(START, length)),
    _last >> (lambda length: Span(END.plus(length, -1.0), None)),
    ~keyword("from (the) [start|beginning]") + _until + _hedge + (moment | _middle_point)
    >> (lambda end: Span(START, end)),
    keyword(_TO_THE_END) >> (lambda: Span(START, END)),
    keyword("(for|over|in|during|within) the next") + _length >> (lambda length: Span(NOW, NOW.plus(length))),
    keyword("by") + (_numbered | _counted | keyword("the (very) end") + ~_of_it >> (lambda: END))
    >> (lambda end: Span(START, end, "by")),
    ~keyword("only|just") + _just_then + keyword("only|alone") >> _only_then,
    keyword("only|just") + _just_then >> _only_then,
    _during + keyword("(the) [first|opening]") + _share >> (lambda x: Span(START, TimeExpression(clip=x))),
    _during + keyword("(the) [last|final|closing]") + _share >> (lambda x: Span(TimeExpression(clip=1 - x), None)),
    _during + keyword("(the) [second|latter|later|other|2nd] half") + ~_of_it >> (lambda: Span(HALF_WAY, None)),
    keyword(
        "[toward|near|close to|just before] the (very) end|near (the) end|(in|for) the [last|final] [bit|part|moments]"
    )
    >> (lambda: Span(END, None, "moment")),
    keyword(f"near the (very) [beginning|start]|[as|when|once] the [{PICTURE}] [begins|starts|opens]")
    >> (lambda: Span(START, None, "moment")),
    keyword(
        f"[over|in|during|through] the [course|duration|length] of the (whole|entire) [{PICTURE}]|as the [{PICTURE}] [goes "
        f"on|progresses|plays|runs]|over the (whole|entire|full) [{PICTURE}]"
    )
    >> (lambda: Span(START, None)),
    _during + _nth >> (lambda n: Span(TimeExpression(seconds=n), TimeExpression(seconds=n + 1))),
    keyword("[from|since]") + _nth + ~_goes_on >> (lambda n: Span(TimeExpression(seconds=n), None, "from")),
    keyword("in|within") + duration >> (lambda length: Span(NOW, NOW.plus(length), "in")),
    _since_then >> (lambda start: Span(start, None, "from")),
    _just_then >> (lambda start: Span(start, None, "moment")),
    _for >> (lambda length: Span(NOW, NOW.plus(length), "length")),
    keyword(
        "always|all the [time|while]|all along|(all) the [whole|entire] [time|duration|way]|throughout|forever|at all times|"
        "constantly|from start to finish|from (the) beginning to (the) end|(for|over|during|in|on) [every|each|all] "
        f"(single|the) [frame|frames]|[for|during|throughout|over|across] the (whole|entire) [{PICTURE}|thing]"
    )
    >> (lambda: Span(START, None, "always")),
)
"""A `Span`."""
