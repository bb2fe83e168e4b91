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


_of_one = fraction + keyword("of a|of an|of one") + _unit >> _times
_and_a_half = _unit + keyword("and") + fraction >> (lambda unit, part: _times(1 + part, unit))
duration = either(
    number + _unit >> _times,
    table(
        {
            "half (a)|half of a": 0.5,
            "(a) quarter (of) (a)": 0.25,
            "[a|one] (full|whole)|an": 1.0,
        }
    )
    + _unit
    >> _times,
    ~keyword("a|one") + _and_a_half,
    _of_one,
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
_part_way = either(
    keyword("halfway|half way|midway|mid way")
    + unless(keyword("around|round"))
    + ~(_through | keyword("point") + ~keyword(f"of the [{PICTURE}]"))
    >> (lambda: HALF_WAY),
    keyword(
        f"the (very) middle of the [{PICTURE}]|(the) [midpoint|mid point|midway point] (of the [{PICTURE}])|the [halfway|half way|"
        f"half] [point|mark] (of the [{PICTURE}])|mid clip|the half|half time|the middle of it|the [{PICTURE}] is [half|halfway] "
        "[over|through|done]"
    )
    >> (lambda: HALF_WAY),
    fraction + (_through | _of_it | keyword("of the time|through the time|in")) >> (lambda x: TimeExpression(clip=x)),
    percent + (_through | keyword(f"of the [{PICTURE}]")) >> (lambda x: TimeExpression(clip=x)),
)
"""Moments that are told by how much of the clip is over."""
_counted = ~keyword("the") + _unit + ~keyword("number|no|#") + number >> (lambda unit, x: _times(x, unit))
_frame_number = keyword("[frame|f|fr] (number|no|#)") + number >> (lambda x: TimeExpression(frames=x))
_inside = f"in|into (the) [{PICTURE}]|into it|in the [{PICTURE}]"
_at_t = literal("t (=)|time =") + number + ~keyword("s|sec") >> (lambda x: TimeExpression(seconds=x))
_measured = _at_t | (
    either(number + _unit + ~keyword(f"{_inside}|mark"), keyword("the") + number + _unit + keyword("mark|point"))
    >> _times
)
_fraction_moment = table({"half a": 0.5, "one|a": 1.0}) + _unit >> _times | _of_one
_nth = either(
    number + keyword("th|st|nd|rd|the"),  # "the" is what "th" is spelt as
    table({word: float(n) for n, word in enumerate(ORDINALS, 1)}),
)
_numbered = ~keyword("the") + number + either(keyword("th|st|nd|rd"), keyword("[th|st|nd|rd|the] frame")) >> (
    lambda x: TimeExpression(frames=x)
)
_hedge = ~literal(
    "like|say|maybe|somewhere around|about|around|roughly|approximately|circa|exactly|precisely|right|just|shortly|some"
)
_after_start = duration + keyword(f"(after|into|from) (the) (very) [beginning|start] (of the [{PICTURE}])") >> (
    lambda length: START.plus(length)
)
_before_end = duration + keyword(f"before (the) end (of the [{PICTURE}])|from the end (of the [{PICTURE}])") >> (
    lambda length: TimeExpression(clip=1.0).plus(length, -1.0)
)
_second_over = keyword("the") + _nth + keyword("second (is over|has passed)") >> (lambda n: TimeExpression(seconds=n))
"""What is after the second second is after two seconds."""
_edge_of_second = keyword("the") + table({"(very) end": 0.0, "(very) [start|beginning]": -1.0}) + keyword("of the") + (
    _nth + keyword("second")
) >> (lambda shift, n: TimeExpression(seconds=n + shift))
moment = ~literal("(the) [timecode|time code|timestamp|time|tc|mark]") + either(
    _after_start,
    _edge_of_second,
    _edge,
    ~keyword("a|one") + _and_a_half,
    _numbered,
    _counted,
    _before_end,
    _measured,
    _fraction_moment,
    _clock,
    _part_way,
)
_to = keyword("(right|through|all the way|on|up) [to|until|up to|up until]|-|through|and")
_pair = either(
    moment + _to + moment >> (lambda a, b: (a, b)),
    ~keyword("the") + _unit + number + _to + number >> (lambda unit, a, b: (_times(a, unit), _times(b, unit))),
    number + _to + number + _unit >> (lambda a, b, unit: (_times(a, unit), _times(b, unit))),
    number + _unit + _to + number >> (lambda a, unit, b: (_times(a, unit), _times(b, unit))),
    (percent | fraction) + ~(_of_it | _through) + _to + (percent | fraction) + (_of_it | _through)
    >> (lambda a, b: (TimeExpression(clip=a), TimeExpression(clip=b))),
    (percent | fraction) + keyword("in") + _to + (percent | fraction)
    >> (lambda a, b: (TimeExpression(clip=a), TimeExpression(clip=b))),
    keyword("the (very) middle|halfway|half way") + _to + keyword("the (very) end") + ~_of_it
    >> (lambda: (HALF_WAY, END)),
    keyword("the (very) [start|beginning]") + _to + keyword("the (very) middle|halfway|half way") + ~_of_it
    >> (lambda: (START, HALF_WAY)),
)
_portion = ~keyword(
    "(in|for|during|over|across|within) (the|all|every|each) [part|bit|section|segment|stretch|piece|portion|interval|time|second|"
    "seconds|frames|passage|range]"
)
_pair_between = either(
    _portion
    + keyword("between")
    + (
        _pair
        | (percent | fraction) + _to + (percent | fraction)
        >> (lambda a, b: (TimeExpression(clip=a), TimeExpression(clip=b)))
    ),
    keyword("(in|for|during) the [second|seconds|part|time] [between|from]")
    + number
    + _to
    + number
    + ~keyword("seconds|s")
    >> (lambda a, b: (TimeExpression(seconds=a), TimeExpression(seconds=b))),
)
_pair_from = (
    _portion
    + ~keyword("from|since|in|during|for|over|within|across|at|starting [at|from|in]|beginning [at|from|in]|on")
    + _pair
)
_length = either(
    duration,
    optional(number, 1.0) + _unit >> _times,
)
_over = ~keyword(
    "[for|in|during|over|within|throughout|on|at|across|inside|through] (only|just)|over the course of|in the course of"
)
_whole_s = ~keyword(f"[the|this] [{PICTURE}] 's")
_first = _over + _whole_s + keyword("(the) (very) [first|opening|initial|starting]") + _length + ~_of_it
_last = _over + _whole_s + keyword("(the) (very) [last|final|closing|ending|concluding]") + _length + ~_of_it
_TO_THE_END = "[until|to|through to|through|up until] the (very) end|all the way (through) to the (very) end"
_goes_on = keyword(
    "(and) [on|onward|forward|after|beyond|later|up]|on out|or later|on forever|"
    f"(right) [{_TO_THE_END}]|for good|for the [rest|remainder] (of the [{PICTURE}]|of it)|and stay so"
)
_onward = ~_goes_on
_FRAMES = (
    "(in|on|for|during|over) [every|all|any|each] (the|of the) [frame|frames|time|second|seconds]|(for) everything"
)
_since = keyword(
    "(right) from|after|since|ever since|as of|as from|once|not before|beginning|from (about) after|[no|not] [earlier|sooner] "
    f"than|(any) (time) later than|({_FRAMES}|any time|at any time) [after|from|past|beyond|since]|starting|starting [at|from|in|"
    "with|on]|beginning [at|from|in|with]|start at"
)
_until = keyword(
    "until|before|(right|all the way) [up to|up until]|not after|[no|not] later than|[no|not] longer than (until)|ending [at|"
    f"with|on|in]|({_FRAMES}|any time|at any time) [before|until|up to]"
)
_middle_point = keyword(f"the middle (of the [{PICTURE}])") >> (lambda: HALF_WAY)
_reaches = (
    "[we|it|you] [reach|reaches|hit|hits|get to|gets to|are at|is at|are|is]|the [clip|video|film|scene|clock|timer|time] "
    "[reaches|hits|shows|is at|gets to]"
)
_at = keyword("at|@|in|on|around|about|near|exactly at|right at|when|as soon as") | keyword(
    "once|when|as soon as"
) + keyword(_reaches)
_comes = ~keyword("[is|has been] reached|comes|starts|begins|arrives|is there")
_bare = either(_after_start, duration + keyword(_inside), _part_way, _before_end, _frame_number)
"""Moments that need no word before them: "two seconds in"."""
_has_passed = (
    keyword("[once|after|when|as soon as] (the first)")
    + _length
    + keyword("[has|have] [passed|gone by|elapsed|gone]|[is|are] [over|up|through|done|gone]|[passes|elapses]")
)
_part = table({**FRACTIONS, "two thirds": 2 / 3, "three quarters": 0.75}) + ~keyword(f"of the [{PICTURE}]")
_half_over = keyword("after|past|once|when|as soon as") + either(
    keyword("the first") + _part,
    _part
    + keyword(f"(of) the ([whole|entire]) [{PICTURE}|time]|(of) it")
    + ~keyword("[is|has] [over|passed|gone|done|through|played|gone by|run]"),
) >> (lambda x: TimeExpression(clip=x))
"""From where a part of the clip is over: "after the first half", "after half the clip"."""
_share_has_passed = keyword("once|after|when|as soon as|until") + fraction + ~keyword("of") + keyword(
    f"(the|this|my) [{PICTURE}] [is|has] [over|passed|gone|done|through|played|gone by|run]"
) >> (lambda x: TimeExpression(clip=x))
_wait_over = keyword("(,|.) [(and) (only) then|before|and]")
_since_then = either(
    _share_has_passed,
    _half_over + _onward,
    _since + _hedge + (moment | _middle_point) + _comes + _onward,
    keyword("from") + percent + keyword("on|onward") >> (lambda x: TimeExpression(clip=x)),
    keyword("[with|when|once] (there [is|are])")
    + duration
    + keyword("([is|are]) [left|remaining|to go]|[remains|remain]")
    >> (lambda length: TimeExpression(clip=1.0).plus(length, -1.0)),
    keyword("wait (for)") + duration + _wait_over >> START.plus,
    keyword("wait until") + moment + _wait_over,
    keyword("(right) after|past|once|when") + ~keyword(_reaches) + _second_over + _onward,
    _since + keyword("the (very) [first|opening]") + _length + _onward >> START.plus,
    (_measured | _counted) + _goes_on,
    _has_passed,
)
_just_then = (
    unless(keyword("in here"))
    + _at
    + _hedge
    + (moment | here(lambda reading, at: reading.word(at - 1) in ("around", "about", "near")) + _middle_point)
    + ~keyword("exactly|precisely|sharp|or so|or thereabouts")
    + _comes
    + ~keyword("[is|are|has] [over|passed|up|done]")
    | _hedge + _bare
) + _onward
_begin = _since_then | _just_then
_for = (
    keyword("for|lasting|over|within|during|over the course of|over a period of|in the course of|taking|spanning")
    + _hedge
    + duration
)
_during = ~keyword("for|in|during|over|within|throughout|across")
_within = _during + keyword("the")
_leading = _during + keyword("(the) [first|opening]") + _part >> (lambda x: Span(START, TimeExpression(clip=x)))
_closing = _during + keyword("(the) [last|final|closing]") + _part >> (lambda x: Span(TimeExpression(clip=1 - x), None))
_central = _within + keyword("middle|central") + either(
    _part >> (lambda x: TimeExpression(clip=x)),
    _length,
    keyword("part|section|bit|stretch|segment|portion") >> (lambda: TimeExpression(clip=1 / 3)),
) >> (lambda length: Span(HALF_WAY.plus(length, -0.5), HALF_WAY.plus(length, 0.5)))
_nth_second = _within + _nth + keyword("second") >> (
    lambda n: Span(TimeExpression(seconds=n - 1), TimeExpression(seconds=n))
)
_loosely = keyword(
    "(in|during|for|over) the [last|final|closing] [bit|part|moments]|"
    "[toward|near|close to|just before|shortly before|right before] the (very) end|near (the) end"
)
_second_half = (
    here(lambda reading, at: "half" in reading.words[:at])
    + keyword("in the [second|other]")
    + unless(keyword("half|third|second"))
    >> (lambda: Span(HALF_WAY, None))
) | _during + keyword("(the) [second|latter|later|other|2nd] half") + ~keyword(f"of the [{PICTURE}]") >> (
    lambda: Span(HALF_WAY, None)
)
_second_third = _during + keyword("(the) [second|2nd] third") + ~keyword(f"of the [{PICTURE}]") >> (
    lambda: Span(TimeExpression(clip=1 / 3), TimeExpression(clip=2 / 3))
)


def _lasting(start: TimeExpression, length: TimeExpression) -> Span:
    return Span(END.plus(length, -1.0), None) if start == END else Span(start, start.plus(length))


def _only_then(start: TimeExpression) -> Span:
    return Span(start, None, "moment") if start in (START, END) else Span(start, start)


_comma = ~keyword(",")
_mid = keyword(f"in the (very) middle (of the [{PICTURE}])")
span = either(
    (_pair_from | _pair_between) >> (lambda pair: Span(*pair)),
    _for + _comma + ~keyword("starting|beginning") + _begin >> (lambda length, start: _lasting(start, length)),
    _begin + _comma + _for >> _lasting,
    _begin
    + _comma
    + keyword("(and) [(right|all the way) [until|up to|up until]|[no|not] later than|ending [at|with|on|in]]")
    + _hedge
    + (moment | _middle_point)
    >> Span,
    keyword("for the [rest|remainder]") + ~_of_it + _begin >> (lambda start: Span(start, None, "from")),
    either(_mid + _comma + _for, _for + _comma + _mid)
    >> (lambda length: Span(HALF_WAY.plus(length, -0.5), HALF_WAY.plus(length, 0.5))),
    _first >> (lambda length: Span(START, length)),
    _last >> (lambda length: Span(END.plus(length, -1.0), None)),
    ~keyword("from (the) [start|beginning]") + _until + _hedge + (moment | _middle_point)
    >> (lambda end: Span(START, end)),
    _until
    + ~keyword("the first")
    + _length
    + keyword("[is|are] [over|up|done|through]|[has|have] [passed|ended|gone by]")
    >> (lambda length: Span(START, length)),
    keyword(f"{_TO_THE_END}|before the [{PICTURE}] [ends|is over|stops|finishes]") >> (lambda: Span(START, END)),
    keyword("(for|over|in|during|within) the next") + _length >> (lambda length: Span(NOW, NOW.plus(length))),
    keyword("for the [rest|remainder]") + ~_of_it >> (lambda: Span(NOW, None, "from")),
    keyword("by")
    + (
        _numbered
        | _counted
        | keyword("the") + number + _unit + keyword("mark|point") >> _times
        | keyword(f"the (very) end (of the [{PICTURE}])") >> (lambda: END)
    )
    >> (lambda end: Span(START, end, "by")),
    keyword("[before|until] the") + _nth + keyword("second") >> (lambda n: Span(START, TimeExpression(seconds=n - 1))),
    ~keyword("only|just") + _just_then + keyword("only|alone") >> _only_then,
    keyword("only|just") + _just_then >> _only_then,
    _leading,
    _closing,
    _second_half,
    _second_third,
    _central,
    _nth_second,
    _loosely >> (lambda: Span(END, None, "moment")),
    keyword("(in|during|for|over) the [first bit|first moments|intro|opening]|near the (very) [beginning|start]")
    >> (lambda: Span(START, None, "moment")),
    keyword(f"[as|when|once|as soon as|the [moment|second|instant]] the [{PICTURE}] [begins|starts|is starting|opens]")
    >> (lambda: Span(START, None, "moment")),
    keyword(f"[as|when] the [{PICTURE}] [ends|is ending|is over|stops|finishes]")
    >> (lambda: Span(END, None, "moment")),
    keyword(
        f"[over|in|during|through] the [course|duration|length] of the (whole|entire) [{PICTURE}]|as the [{PICTURE}] [goes on|"
        f"progresses|plays|runs|advances|unfolds]|over the (whole|entire|full) [{PICTURE}]"
    )
    >> (lambda: Span(START, None)),
    keyword("[from|since] the") + _nth + keyword("second") + _onward
    >> (lambda n: Span(TimeExpression(seconds=n - 1), None, "from")),
    keyword("in|within") + duration >> (lambda length: Span(NOW, NOW.plus(length), "in")),
    _since_then >> (lambda start: Span(start, None, "from")),
    _just_then >> (lambda start: Span(start, None, "moment")),
    _for >> (lambda length: Span(NOW, NOW.plus(length), "length")),
    table(
        {
            "always|all the [time|while]|all along|(all) the [whole|entire] [time|duration]|(for|over|during) the [whole|entire] "
            "thing|for the (whole|entire|full) [duration|length] (of the [clip|video|film|scene|shot|footage|recording|movie|"
            "sequence])|all the way through|(in|on|for) [every|each] (single) frame|all of the time|[for|during|throughout] the "
            "[whole|entire] [clip|video|time|film|shot|footage|movie|sequence|scene]|throughout|throughout the [clip|video|film|"
            "scene]|forever|the [entire|whole] way|the whole way through|from start to finish|from (the) beginning to (the) end|"
            "(over|for) the whole duration|[over|during|throughout|across] the (whole|entire) [clip|video|film|scene|footage|shot|"
            "movie|sequence|recording]|at all times|in every frame|[in|on|for] all (the) frames|on every frame|constantly|"
            "perpetually|for its [entire|whole] length|from the first (frame) to the last (frame)": Span(
                START, None, "always"
            )
        }
    ),
)
"""A `Span`."""
