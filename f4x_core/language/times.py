"""When: moments, durations and spans of a clip, in seconds, frames, time codes and words."""
# ruff: noqa: F401  # phrases name what they are made of

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from .amounts import fraction, number, percent
from .grammar import VOCABULARY, either, here, literal, optional, table
from .lexicon import FRACTIONS, ORDINALS, PICTURE, PLACES
from .notation import Notation


@dataclass
class Clip:
    """Times of a clip, in which moments of a sentence are counted."""

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
        """Return this time plus `sign` times the other."""
        return TimeExpression(*(a + sign * b for a, b in zip(self, other, strict=True)))

    def resolve(self, context: Clip) -> float:
        """Clip frame, maybe outside the clip."""
        last = context.frames - 1
        counted = self.frames + self.seconds * context.fps + self.last * last + self.now * context.frame
        return round(counted + self.clip * context.frames, PLACES)


START, END, NOW = TimeExpression(), TimeExpression(last=1.0), TimeExpression(now=1.0)
HALF_WAY = TimeExpression(clip=0.5)


def no_such_time(time: TimeExpression, clip: Clip) -> str:
    """Return the sentence about a time that the clip does not have, in the unit that it was given in."""
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
    `in`: after so long, or for so long; `later`: so long after the time given before; `always`."""


_say = Notation(globals(), VOCABULARY)
_unit = table(
    {
        "second|seconds|sec|secs|s|second mark": TimeExpression(seconds=1.0),
        "frame|frames|f|fr|frm|frms": TimeExpression(frames=1.0),
        "minute|minutes|min|mins": TimeExpression(seconds=60.0),
        "beat|beats": TimeExpression(seconds=0.5),
        "msec|millisecond|milliseconds|ms": TimeExpression(seconds=0.001),
    }
)


def _times(x: float, unit: TimeExpression) -> TimeExpression:
    return TimeExpression().plus(unit, x)


def _part(x: float) -> TimeExpression:
    """Return the fraction `x` of the clip."""
    return TimeExpression(clip=x)


_part_of_unit = table({"half (a)": 0.5, "(a) quarter (of) (a)": 0.25, "[a|one] (full|whole)|an": 1.0})
duration = _say.table(
    {
        "<number> <_unit>|<_part_of_unit> <_unit>": _times,
        "a (little|short|brief) [moment|bit|while]": lambda: TimeExpression(seconds=1.0),
        "(a|one) <_unit> and <fraction>": lambda unit, part: _times(1 + part, unit),
    }
)
_edge = table(
    {
        f"the (very) [beginning|start|first frame|outset|head|opening] (of the [{PICTURE}])|start|beginning|first frame": START,
        f"the (very) [end|last frame|finish|tail|close] (of the [{PICTURE}])|end|last frame": END,
        "now|here|this [frame|moment|point]|the [present|current] [frame|moment]": NOW,
    }
)
_clock = _say.table(
    {
        "<number> : <number> : <number> : <number>": lambda h, m, s, f: TimeExpression(f, 3600 * h + 60 * m + s),
        "<number> : <number> : <number>": lambda h, m, s: TimeExpression(seconds=3600 * h + 60 * m + s),
        "<number> : <number> (minutes)": lambda m, s: TimeExpression(seconds=60 * m + s),
    }
)
_of_it = _say(f"of the [{PICTURE}]|of it")
_through = _say(f"[(of the way) [through|in|into|along]|of the way] (the (whole) [{PICTURE}]|it)")
_share = table({**FRACTIONS, "two thirds": 2 / 3, "three quarters": 0.75}) + ~_of_it
_middle_point = _say.table({f"the middle (of the [{PICTURE}])|halfway|half way": HALF_WAY})
_part_way = _say.table(
    {
        f"[halfway|half way|midway|mid way] ![around|round] (<_through>|point (of the [{PICTURE}]))|the (very) middle of the "
        f"[{PICTURE}]|(the) [midpoint|mid point]|the [halfway|half way|half] [point|mark]": HALF_WAY,
        "<fraction> [<_through>|<_of_it>|of the time|through the time|in]": _part,
        f"<percent> [<_through>|of the [{PICTURE}]]": _part,
    }
)
"""Moments that are told by how much of the clip is over."""
_counted = _say("(the) <_unit> (number|no|#) <number>") >> (lambda unit, x: _times(x, unit))
_clock_reads = literal("t (=)|time =") + number
_one_unit = table({"half a": 0.5, "one|a": 1.0}) + _unit
_measured = _say.table(
    {
        "<_clock_reads> (s|sec)": lambda x: TimeExpression(seconds=x),
        f"(the) <number> <_unit> (in|into (the) [{PICTURE}]|into it|mark|point)|<_one_unit>": _times,
    }
)
_numbered = _say("(the) <number> [(th|st|nd|rd|the) frame|th|st|nd|rd]") >> TimeExpression
_nth = table({f"the {word} second": float(n) for n, word in enumerate(ORDINALS)})
_hedge = ~literal(
    "like|say|maybe|about|around|roughly|approximately|circa|exactly|precisely|right|just|shortly|some|somewhere around"
)
_before_end = _say(f"<duration> [before (the) end (of the [{PICTURE}])|from the end (of the [{PICTURE}])]") >> (
    lambda length: END.plus(length, -1.0)
)
moment = ~literal("(the) [timecode|time code|timestamp|time|tc|mark]") + either(
    _edge, _numbered, _counted, _before_end, _measured, _clock, _part_way
)
_point = moment | _middle_point
_pair = _say.table(
    {
        "<moment> <_to> <_point>": Span,
        "(the) <_unit> <number> <_to> <number>": lambda unit, a, b: Span(_times(a, unit), _times(b, unit)),
        "<number> <_to> <number> <_unit>": lambda a, b, unit: Span(_times(a, unit), _times(b, unit)),
        "<number> <_unit> <_to> <number>": lambda a, unit, b: Span(_times(a, unit), _times(b, unit)),
    },
    _to=_say("(right|through|all the way|on|up) [to|until|up to|up until]|-|through|and"),
)
_length = duration | optional(number, 1.0) + _unit >> _times
_over = ~_say("[for|in|during|over|within|throughout|on|at|across] (only|just)|[over|in] the course of")
_first = _say("<_over> (the) (very) [first|opening|initial|starting] <_length> (<_of_it>)")
_last = _say("<_over> (the) (very) [last|final|closing] <_length> (<_of_it>)")
_TO_THE_END = "[until|to|through to|through|up until] the (very) end|all the way to the end"
_goes_on = _say(
    f"(and) [on|onward|forward|after|beyond|later|up]|or later|(right) [{_TO_THE_END}]|for good|for the [rest|remainder] "
    f"(of the [{PICTURE}]|of it)"
)
_FRAMES = "[every|all|any|each] (the|of the) [frame|frames|time|second|seconds]|(for) everything"
_since = _say(
    "(right) [from|after]|since|as of|as from|once|not before|[no|not] [earlier|sooner] than|([in|on|for]) "
    f"({_FRAMES}) [after|from|past|since]|starting ([at|from|in|with|on])|beginning ([at|from|in|with])|start (at)"
)
_until = _say(
    f"until|before|(right|all the way) [up to|up until]|[no|not] later than|[end|ending] [at|with|on|in]|({_FRAMES}) [before|until]"
)
_at = _say(
    "at|@|in|on|around|about|near|when|as soon as|[once|when|as soon as] [[we|it|you] [reach|hit|get to|are at|is at]|"
    "the [clip|video|clock|timer|time] [reaches|hits|shows]]"
)
_passed = _say("[is|are] [over|up|through|done]|[has|have] [passed|gone by|elapsed]|[passes|elapses]")
_since_then = _say.table(
    {
        "<_since> <_hedge> <_point> (<_goes_on>)": lambda start: start,
        f"[after|past|once|when] [the first <_share>|<_share> (of) the (whole) [{PICTURE}|time] (<_passed>)]": _part,
        "<_since> the (very) [first|opening] <_length> (<_goes_on>)": START.plus,
        "[<_measured>|<_counted>] <_goes_on>": lambda start: start,
    }
)
_nearby = here(lambda reading, at: reading.word(at - 1) in ("around", "about", "near"))
_just_then = _say(
    f"![in here] [<_at> <_hedge> [<moment>|<_nearby> <_middle_point>] (exactly|precisely|sharp|or so)|<_hedge> [<duration> "
    f"[in|into (the) [{PICTURE}]|into it|in the [{PICTURE}]]|<_part_way>|<_before_end>|<_frame_number>]] (<_goes_on>)",
    _frame_number=_say("[frame|f|fr] (number|no|#) <number>") >> TimeExpression,
)
_begin = _since_then | _just_then
_for = _say("[for|lasting|over|within|during|over the course of|over a period of|taking|spanning] <_hedge> <duration>")
_during = _say("(for|in|during|over|within|throughout|across)")
_by_then = _numbered | _counted | _say("the (very) end (<_of_it>)") >> (lambda: END)
_mid = _share >> _part | _length


def _lasting(start: TimeExpression, length: TimeExpression) -> Span:
    return Span(END.plus(length, -1.0), None) if start == END else Span(start, start.plus(length))


def _only_then(start: TimeExpression) -> Span:
    return Span(start, None, "moment") if start in (START, END) else Span(start, start)


span = _say.table(
    {
        "(from|since|in|during|for|over|within|across|at|between|starting [at|from|in]|beginning [at|from|in]|on) "
        "<_pair>": lambda pair: pair,
        "<_for> (,) (starting|beginning) <_begin>": lambda length, start: _lasting(start, length),
        "<_begin> (,) <_for>": _lasting,
        "<_begin> (,) (and) [(right|all the way) [until|up to|up until]|[no|not] later than|ending [at|with|on|in]] <_hedge> "
        "<_point>": Span,
        "<_during> the [middle|central] <_mid>": lambda x: Span(HALF_WAY.plus(x, -0.5), HALF_WAY.plus(x, 0.5)),
        "<_first>": lambda length: Span(START, length),
        "<_last>": lambda length: Span(END.plus(length, -1.0), None),
        "(from (the) [start|beginning]) <_until> <_hedge> <_point>": lambda end: Span(START, end),
        _TO_THE_END: Span(START, END),
        "[(for|over|in|during|within) the next] <_length>": lambda length: Span(NOW, NOW.plus(length)),
        "by <_by_then>": lambda end: Span(START, end, "by"),
        "by <_by_then> (,) <_since> <_point>": lambda end, start: Span(start, end),
        "(only|just) <_just_then> [only|alone]|[only|just] <_just_then>": _only_then,
        "<_during> (the) [first|opening] <_share>": lambda x: Span(START, _part(x)),
        "<_during> (the) [last|final|closing] <_share>": lambda x: Span(_part(1 - x), None),
        "<_during> (the) [second|latter|later|other|2nd] half (<_of_it>)": Span(HALF_WAY, None),
        "[toward|near|close to|just before] the (very) end|near (the) end|(in|for) the [last|final] "
        "[bit|part|moments]": Span(END, None, "moment"),
        f"near the (very) [beginning|start]|[as|when|once] the [{PICTURE}] [begins|starts|opens]": Span(
            START, None, "moment"
        ),
        f"[over|in|during|through] the [course|duration|length] of the (whole|entire) [{PICTURE}]|as the [{PICTURE}] [goes "
        f"on|progresses|plays|runs]|over the (whole|entire|full) [{PICTURE}]": Span(START, None),
        "<_during> <_nth>": lambda n: Span(TimeExpression(seconds=n), TimeExpression(seconds=n + 1)),
        "[from|since] <_nth> (<_goes_on>)": lambda n: Span(TimeExpression(seconds=n), None, "from"),
        "[in|within] <duration>": lambda length: Span(NOW, NOW.plus(length), "in"),
        "<duration> [later|afterward|after that]": lambda length: Span(length, None, "later"),
        "<_since_then>": lambda start: Span(start, None, "from"),
        "<_just_then>": lambda start: Span(start, None, "moment"),
        "<_for>": lambda length: Span(NOW, NOW.plus(length), "length"),
        "always|all the [time|while]|all along|(all) the [whole|entire] [time|duration|way]|throughout|forever|at all times|"
        "constantly|from start to finish|from (the) beginning to (the) end|(for|over|during|in|on) [every|each|all] "
        f"(single|the) [frame|frames]|[for|during|throughout|through|over|across] [the (whole|entire)|whole|"
        f"entire] [{PICTURE}|thing]": Span(START, None, "always"),
    }
)
"""A `Span`."""
