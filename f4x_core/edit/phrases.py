"""Phrases of edits: who, when, how much, which way. A `SentenceContext` resolves what depends on the clip, once all is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

from ..errors import F4xError
from .colour_names import COLOURS, SHADES, Colour, from_hex, shaded
from .grammar import (
    VOCABULARY,
    Mismatch,
    Reading,
    Rule,
    either,
    generated,
    listed,
    lit,
    optional,
    sign,
    silent,
    table,
    tokenise,
)
from .operations import Duplicate, Vector
from .selects import All, And, Current, Instance, Moving, Named, Not, Or, Point, SelectKind, Text
from .words import EVERYBODY, FRACTIONS, FUNCTION_WORDS, NO_THINGS, ONES, TENS, singular, word_set

PLACES = 3
"""Decimals that numbers worked out from words keep."""


class Refusal(F4xError):  # noqa: N818  # nothing went wrong
    """A sentence that is not understood, or asks for what cannot be."""

    def __init__(self, reason: str, nearest: tuple[str, ...] = ()):
        """`reason`: why, one sentence; `nearest`: commands that are known, as example sentences."""
        hint = " Try: " + "; ".join(f'"{example}"' for example in nearest) + "." if nearest else ""
        super().__init__(reason + hint)
        self.reason = reason
        self.nearest = nearest


@dataclass
class SentenceContext:
    """The clip and names that a sentence refers to, and what the sentence has named so far."""

    fps: float
    """Clip frames per second."""
    frames: int
    """Frames of the clip."""
    frame: float = 0.0
    """The present one."""
    selected: bool = False
    """Something is selected at present."""
    names: dict[str, str] = field(default_factory=dict)
    """Names of selections in lower case -> as they were given."""
    last: SelectKind | None = None
    """The last thing named: "it"."""
    they: SelectKind | None = None
    """All that the last command was about: "them"."""
    copies: dict[str, SelectKind] = field(default_factory=dict)
    """Name of the copies of each command that made some, the last one last -> what was copied."""
    spare: set[str] = field(default_factory=set)
    """Those of the names that nobody gave."""
    earlier: Mapping[SelectKind, SelectKind] = field(default_factory=dict)
    """The copies of each earlier command that made some, the last one last -> what was copied."""

    @property
    def present(self) -> int:
        """The clip frame through which "the left one" is seen."""
        return min(max(round(self.frame), 0), self.frames - 1)

    def it(self, word: str) -> SelectKind:
        """The last thing named, else what is selected; Refusal when there is neither."""
        if self.last is None and not self.selected:
            raise Refusal(f"Nothing is named or selected that {word} could be; name a thing or select one.")
        return self.last or Current()

    def one(self) -> SelectKind:
        """Return the kind that "the left one" picks from: that of the last thing named, after copying with its copies."""
        select = self.it("'one'")
        if isinstance(select, Named) and select.name in self.copies:
            return together((self.copies[select.name], select))
        return select.of if isinstance(select, Instance) else select

    def copied(self, operation: Duplicate) -> tuple[Duplicate, SelectKind]:
        """The operation with a name for its copies, which are "it" from now on; and "they": a single one and its original."""
        name = operation.name
        if not name:
            name = f"{COPY} {len(self.copies) + 1}" if self.copies else COPY
            self.spare.add(name)
        self.copies[name] = operation.select
        self.last = Named(name)
        return replace(operation, name=name), self.one() if operation.count == 1 else self.last

    def and_copies(self, select: SelectKind) -> SelectKind:
        """Return the selection of a plural noun: the object and the copies that the sentence made of it."""
        return together((select, *(Named(name) for name, who in self.copies.items() if who == select)))


# How much ------------------------------------------------------------------------------------------------------------


def _number_at(reading: Reading, at: int) -> Iterator[tuple[int, float]]:
    word, following = reading.word(at), reading.word(at + 1)
    if word[:1].isdecimal() or word[:1] == ".":
        try:
            number = float(word)
        except ValueError:  # a digit of another script
            return
        below = reading.word(at + 2)
        if following == "/" and below.isdecimal() and float(below):
            yield at + 3, number / float(below)
        yield at + 1, number
    elif word in TENS:
        if 0 < ONES.get(following, 0) < 10:
            yield at + 2, float(TENS[word] + ONES[following])
        yield at + 1, float(TENS[word])
    elif word in ONES:
        if following == "hundred":
            yield at + 2, 100.0 * ONES[word]
        if following == "and" and reading.word(at + 2) == "a" and reading.word(at + 3) == "half":
            yield at + 4, ONES[word] + 0.5
        if following == "point" and reading.word(at + 2) in ONES:
            yield at + 3, ONES[word] + ONES[reading.word(at + 2)] / 10
        yield at + 1, float(ONES[word])
    elif word in ("a", "one") and following == "hundred":
        yield at + 2, 100.0


number = generated(_number_at)
signed = (lit("-|minus") + number >> (lambda x: -x)) | number
VOCABULARY.update(ONES, TENS, FRACTIONS)

_percent_sign = lit("%|percent|per cent|pct")
percent = number + _percent_sign >> (lambda x: x / 100)
fraction = table(
    {
        "half|one half|a half": 0.5,
        "a third|one third": 1 / 3,
        "a quarter|one quarter": 0.25,
        "two thirds": 2 / 3,
        "three quarters": 0.75,
        "a fifth|one fifth": 0.2,
        "a tenth|one tenth": 0.1,
    }
)
multiple = either(
    number + lit("times|x|fold"), table({"twice|double|doubly": 2.0, "thrice|triple": 3.0, "quadruple": 4.0}), fraction
)
"""A factor: "three times", "2x", "twice", "half"."""


class Amount(NamedTuple):
    """An amount: a little, much, times, a fraction more or less, or to a fraction."""

    kind: str
    """`small`, `large`, `times`, `fraction`, `to`."""
    value: float = 1.0
    """Of the last three."""


degree = table(
    {
        "(just) a [little|tiny|wee|small] bit|(just|only) a [little|tad|touch|bit]|slightly|somewhat|a smidge|a hair": Amount(
            "small"
        ),
        "much|(quite) a lot|far|way|a great deal|lots|considerably|significantly|a good deal|very much": Amount(
            "large"
        ),
    }
)
_by_factor = lit("by") + ~lit("a") + lit("factor") + ~lit("of")
amount = either(
    degree,
    _by_factor + (multiple | number) >> (lambda x: Amount("times", x)),
    ~lit("by") + percent >> (lambda x: Amount("fraction", x)),
    lit("by") + fraction >> (lambda x: Amount("fraction", x)),
    ~lit("by") + multiple >> (lambda x: Amount("times", x)),
)
SMALL_STEP, LARGE_STEP, STEP = (1.2, 0.83), (2.0, 0.5), (1.5, 0.67)
"""Factors up and down: a bit, much, and without a degree."""


def factor(how: Amount | None, upward: bool) -> float:
    """The factor of something that gets more (`upward`) or less by an amount; Mismatch where it would be none."""
    if how is None or how.kind in ("small", "large"):
        up, down = STEP if how is None else SMALL_STEP if how.kind == "small" else LARGE_STEP
        return up if upward else down
    if how.kind == "to":
        return how.value
    if how.kind == "fraction":
        return round(1 + how.value if upward else 1 - how.value, PLACES)
    if how.value <= 0:
        raise Mismatch
    return round(how.value if upward or how.value < 1 else 1 / how.value, PLACES)


def comparison(comparatives: str, lesser: str, positives: str, opposites: str) -> Rule:
    """A factor from "bigger", "a bit smaller", "three times bigger", "twice as big", "20 % smaller", "less big"."""
    compared = table({comparatives: True, lesser: False})
    plain = table({positives: True, opposites: False})
    more = either(compared, lit("more") + plain, lit("less") + plain >> (lambda upward: not upward))
    so = lit("as") + plain + ~(lit("as") + ~lit("it|they|he|she|that|this") + lit("is|are|was|were|before|now"))
    return either(
        optional(amount) + more >> factor,
        more + amount >> (lambda upward, how: factor(how, upward)),
        multiple + so >> (lambda x, upward: factor(Amount("times", x), True) if upward else _inverse(x)),
        percent + so >> (lambda x, upward: x if upward else _inverse(x)),
    )


def _inverse(x: float) -> float:
    if x <= 0:
        raise Mismatch
    return round(1 / x, PLACES)


ITS = "its|their|his|her|the|the original|its own|their own|its original|its current|the current|the normal|normal|the original"


def fraction_of(quality: str) -> Rule:
    """A factor from "half the size", "twice its size", "50 % of its size", "double size"."""
    noun = ~lit("of") + ~lit(ITS) + lit(quality)
    return either(multiple, percent) + noun


# Which colour --------------------------------------------------------------------------------------------------------

_MAX_COLOUR_WORDS = 3
"""Words that a colour's name is written in: "light sky blue"."""


def _colour_at(reading: Reading, at: int) -> Iterator[tuple[int, Colour]]:
    word = reading.word(at)
    if word.startswith("#") and len(word) > 1:
        yield at + 1, from_hex(word[1:])
    for count in range(_MAX_COLOUR_WORDS, 0, -1):
        name = "".join(reading.word(i) for i in range(at, at + count))
        if name in COLOURS and at + count <= len(reading.tokens):
            yield at + count, COLOURS[name]
    if word in SHADES:
        for end, (base,) in colour.at(reading, at + 1).items():
            yield end, shaded(word, base)


colour = generated(_colour_at)
GRAY: Colour = COLOURS["gray"]
_REDDER = {name + "er": name for name in ("green", "yellow", "pink", "brown", "black", "gray")}
_REDDER |= {"redder": "red", "bluer": "blue", "whiter": "white", "purpler": "purple", "oranger": "orange"}
_REDDISH = {name + "ish": name for name in ("green", "yellow", "pink", "brown", "gray", "black", "orange")}
_REDDISH |= {"reddish": "red", "bluish|blueish": "blue", "whitish": "white", "purplish": "purple", "goldish": "gold"}
colourish = table({word: COLOURS[name] for word, name in _REDDISH.items()})
more_colour = either(
    table({word: COLOURS[name] for word, name in _REDDER.items()}) >> (lambda rgb: (rgb, 1)),
    lit("more") + colour >> (lambda rgb: (rgb, 1)),
    lit("less") + colour >> (lambda rgb: (rgb, -1)),
)
PURE_COLOURS = word_set(
    "red green blue yellow black white gray brown purple pink cyan magenta turquoise beige crimson maroon navy teal violet "
    "golden scarlet burgundy khaki indigo fuchsia"
)
"""Colour words that are no things: "delete the rose" has an object, "delete the red" has none."""


# When ----------------------------------------------------------------------------------------------------------------


class TimeExpression(NamedTuple):
    """A sum of what a time can be counted in, as clip frame: frames + seconds x rate + last x last frame + now x present one."""

    frames: float = 0.0
    seconds: float = 0.0
    last: float = 0.0
    now: float = 0.0

    def plus(self, other: TimeExpression, sign: float = 1.0) -> TimeExpression:
        """This + sign x the other."""
        return TimeExpression(*(a + sign * b for a, b in zip(self, other, strict=True)))

    def resolve(self, context: SentenceContext) -> float:
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


@dataclass(frozen=True)
class When:
    """A span settled against the clip, in the words of each operation."""

    frames: tuple[float, float | None] | None = None
    """None: no time is given."""
    kind: str = "range"
    """As in `Span`."""

    @classmethod
    def of(cls, phrase: Span | None, context: SentenceContext) -> When:
        """Clip frames of a span; Refusal: outside of the clip, or ending before it starts."""
        if phrase is None or phrase.kind == "always":
            return cls()
        start, end = phrase.start.resolve(context), None if phrase.end is None else phrase.end.resolve(context)
        last = context.frames - 1
        for frame in (start, end):
            # The instant in which the last frame ends is still the clip: "to second 6" of six seconds.
            if frame is not None and not 0 <= frame <= (last if frame is start else last + 1):
                raise Refusal(
                    f"Frame {frame:g} is outside the clip, which has frames 0 to {last} ({context.frames / context.fps:g} s)."
                )
        end = None if end is None or phrase.end == END else min(end, last)
        if end is not None and end < start:
            raise Refusal(f"The time from frame {start:g} to frame {end:g} ends before it starts.")
        return cls((float(start), None if end is None else float(end)), phrase.kind)

    @property
    def effect(self) -> dict[str, Any]:
        """Field `frames` of what is in effect for a while."""
        if self.kind == "length":
            raise Refusal("It is said how long, not from when; add for example 'from second 1'.")
        return {} if self.frames is None else {"frames": self.frames}

    @property
    def growth(self) -> dict[str, Any]:
        """Fields of a transform: grows over a range, jumps at a moment."""
        if self.kind == "moment" and self.frames is not None:
            return {"frames": (self.frames[0], self.frames[0]), "ease": "step"}
        return self.effect

    @property
    def fading(self) -> dict[str, Any]:
        """Fields of an opacity that comes little by little over a range."""
        return self.effect | ({"ease": "linear"} if self.frames is not None and self.kind == "range" else {})

    def pause(self, context: SentenceContext) -> dict[str, Any]:
        """Fields of a freeze."""
        if self.frames is None:
            return {"at": float(context.frame)}
        return {"at": self.frames[0]} | ({} if self.frames[1] is None else {"until": self.frames[1]})

    def none(self, what: str) -> dict[str, Any]:
        """Return no field; raises Refusal where the sentence names a time."""
        if self.frames is not None:
            raise Refusal(f"{what} is for the whole clip; leave the time out.")
        return {}


# Who -----------------------------------------------------------------------------------------------------------------

Who = Callable[[SentenceContext], SelectKind]
"""What an object phrase means; it notes itself as the last thing named."""

_DESCRIBING = word_set("big large small tiny bright dark light fast slow quick static standing still whole little")
"""Words of the grammar that may also stand before a noun."""


def _open(reading: Reading, at: int) -> bool:
    """Whether the word could be (part of) the name of a thing that nobody knows yet."""
    word = reading.word(at)
    return (
        at < len(reading.tokens)
        and reading.tokens[at].is_word
        and word not in FUNCTION_WORDS
        and word not in NO_THINGS
        and (word not in VOCABULARY or word in _DESCRIBING or word in COLOURS)
        and not (word.endswith("ly") and len(word) > 4)
    )


def _known_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Labels and names that stand there, longest first."""
    words = tuple(reading.word(i) for i in range(at, min(at + reading.longest, len(reading.tokens))))
    for count in range(len(words), 0, -1):
        for form in (words[:count], (*words[: count - 1], singular(words[count - 1]))):
            if form in reading.known:
                yield at + count, reading.known[form]
                break


_MAX_MODIFIERS = 3


def _modified_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """A known thing with other words before it: "parked car", "woman's hat"."""
    before = at
    while before - at < _MAX_MODIFIERS and (_open(reading, before) or reading.word(before) in SHADES):
        before += 1
        if reading.word(before) == "'s":
            before += 1
        seen = {reading.word(i) for i in range(at, before)}
        for end, label in _known_at(reading, before):
            if reading.word(end - 1) not in seen:
                yield end, f"{reading.text_of(at, before).lower()} {label}"


def _part_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """A known part of a known whole: "roof of the house"."""
    for middle, part in _known_at(reading, at):
        if reading.word(middle) == "of":
            whole = middle + 1 + (reading.word(middle + 1) in ("the", "a", "an", "that", "this", "my"))
            for end, label in _known_at(reading, whole):
                yield end, f"{part} {reading.text_of(middle, whole).lower()} {label}"


def _stranger_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """One word that no label has."""
    word = reading.word(at)
    if _open(reading, at) and word not in PURE_COLOURS and word not in _DESCRIBING and singular(word) not in NO_THINGS:
        text = reading.text_of(at, at + 1).lower()
        yield at + 1, singular(text)


def _bare_stranger_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """One unknown word without an article, which might be a verb ("and juggle"): where no label is known at all, a plural, or a
    name that the sentence gave before."""
    earlier_words = {token.text for token in reading.tokens[:at]}
    for end, name in _stranger_at(reading, at):
        if not reading.known or name != reading.word(at) or name in earlier_words:
            yield end, name


def _strangers_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Two or three words of which no label has any: "flux capacitor", where an article says that a name begins."""
    end = at
    while end - at < _MAX_MODIFIERS and _open(reading, end) and not any(True for _ in _known_at(reading, end)):
        end += 1
    for last in range(at + 2, end + 1):
        for _, name in _stranger_at(reading, last - 1):
            yield last, f"{reading.text_of(at, last - 1).lower()} {name}"


def _everybody_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """The label of people in "everyone"."""
    if reading.word(at) in ("everyone", "everybody"):
        yield at + 1, next((label for label in EVERYBODY if (label,) in reading.known), EVERYBODY[0])


_several = silent(generated(lambda reading, at: ((end, x) for end, x in _number_at(reading, at) if x >= 2)))
_article = lit(
    "the|a|an|this|that|these|those|my|our|your|its|his|her|their|some|every|each|any|all|all (of) [the|these|those|my]|both|"
    "both (of) the|each of the|any of the|every one of the|every single|the [whole|entire]"
)
_determiner = either(_article + ~_several, _several)


def _things(match: Callable[[Reading, int], Iterator[tuple[int, str]]]) -> Rule:
    """The `Who` of a noun."""

    def thing_at(reading: Reading, at: int) -> Iterator[tuple[int, Who]]:
        for end, label in match(reading, at):
            yield end, _thing(label, _is_plural(reading, end - 1))

    return generated(thing_at)


def _thing(label: str, plural: bool) -> Who:
    def who(context: SentenceContext) -> SelectKind:
        if label == COPY and (context.copies or context.earlier):
            return _the_copy(context)
        name = context.names.get(label.lower())
        alone = context.earlier and not plural  # what was copied in an earlier sentence
        select = Text((label,), number="one" if alone else "any") if name is None else Named(name)
        return context.and_copies(select) if plural else select

    return who


def _always(select: SelectKind) -> Callable[..., Who]:
    return lambda *_: lambda context: select


_OBJECTS = "thing|things|object|objects|item|items|part|parts|stuff|one|ones"
_objects = lit(_OBJECTS)
_known, _part, _modified, _stranger = map(_things, (_known_at, _part_at, _modified_at, _stranger_at))
_everybody, _strangers, _bare_stranger = map(_things, (_everybody_at, _strangers_at, _bare_stranger_at))
familiar = either(_part, _known, _modified, _everybody)
"""A noun that the scene knows."""
_noun = either(_part, _known, _modified, _stranger)
_named_at_length = _article + _strangers
_moving = either(
    lit(
        "what|whatever|all that|[everything|anything|all] [that|which]|(the|all) (the) [things|objects|ones] [that|which]"
    )
    + lit("moves|move|is moving|are moving|is in motion|does move"),
    ~_article + lit("moving") + _objects,
) >> _always(Moving())
_static = either(
    lit(
        "what|whatever|all that|[everything|anything|all] [that|which]|(the|all) (the) [things|objects|ones] [that|which]"
    )
    + lit(
        "stands still|stand still|stays still|stay still|is still|are still|is static|are static|does not move|do not move|"
        "is not moving|are not moving|rests|is at rest|never moves"
    ),
    ~_article
    + lit("static|still|standing|stationary|motionless|unmoving|fixed")
    + either(_objects, lit("background|scene")),
    ~lit("the") + ~lit("whole|entire") + lit("background"),
) >> _always(Not(Moving()))
_moving_noun = ~_article + lit("moving") + _noun >> (lambda noun: lambda context: And((noun(context), Moving())))
_WHICH = {
    "left|leftmost|left most|left hand|far left": "left",
    "right|rightmost|right most|right hand|far right": "right",
    "top|topmost|upper|uppermost|highest|top most": "top",
    "bottom|bottommost|lower|lowest|bottom most": "bottom",
    "middle|central|center|centermost|middlemost": "middle",
    "nearest|closest|front|frontmost|foremost|nearer|closer": "nearest",
    "farthest|furthest|back|rear|rearmost|most distant|backmost|hindmost": "farthest",
    "biggest|largest|bigger|larger": "largest",
    "smallest|tiniest|littlest|smaller": "smallest",
}
_viewer = "the camera|the viewer|the lens|me|us|here"
_WHERE = {
    "on [the|its] (far) left (side|hand side)|at the (far) left": "left",
    "on [the|its] (far) right (side|hand side)|at the (far) right": "right",
    "at the (very) top|on (the) top|on the top side": "top",
    "at the (very) bottom|on the bottom": "bottom",
    "in the (very) [middle|center]|at the center": "middle",
    f"in front|in the front|at the front|[closest|nearest] to [{_viewer}]|closest|nearest": "nearest",
    f"in the back|at the [back|rear]|in the rear|[farthest|furthest] (away) from [{_viewer}]|"
    "farthest (away)|furthest (away)": "farthest",
}
_which, _where = table(_WHICH), ~lit("that is|that are|which is|which are|standing|sitting") + table(_WHERE)
_seen_in = optional(lit("of|as of|seen in|seen at") + lit("frame") + number)
_kind = either(
    _moving,
    _moving_noun,
    _noun,
    ~lit("one|ones") + lit("of (the|these|those|my|all the)") + _noun,
    lit("one|ones") >> (lambda: SentenceContext.one),
)


def _one_of(which: Any, kind: Who, seen: float | None) -> Who:
    def who(context: SentenceContext) -> SelectKind:
        frame = context.present if seen is None else _frame(seen, context)
        of = kind(context)
        of = replace(of, number="any") if isinstance(of, Text) else of  # of a thing and its copies one is the left one
        return Instance(context.and_copies(of), which, frame)

    return who


def _frame(number: float, context: SentenceContext) -> int:
    if number != int(number) or not 0 <= number < context.frames:
        raise Refusal(f"Frame {number:g} is none of the clip's, 0 to {context.frames - 1}.")
    return int(number)


_instance = either(
    ~_article + _which + _kind + _seen_in >> _one_of,
    ~_article + _kind + _where + _seen_in >> (lambda kind, which, seen: _one_of(which, kind, seen)),
)
_place = (
    ~sign("(")
    + ~lit("pixel|position|point|x")
    + ~lit("=|:")
    + number
    + ~lit(",|y|and")
    + ~lit("=|:")
    + number
    + ~sign(")")
)
_point = lit(
    "(the|that|this) [thing|object|item|spot|point|part]|(the) pixel|what is|whatever is|what you see|the one"
) + lit("at|on|under") + _place + optional(lit("in|at|of|on") + lit("frame") + number) >> (
    lambda x, y, seen: lambda context: Point(context.present if seen is None else _frame(seen, context), x, y)
)
_it = lit("it|this|that|him|her|he|she|itself|[this|that|the] [thing|one|object]|all of [it|this|that]|it all") >> (
    lambda: lambda context: context.it("'it'")
)
_they = lit(
    "them|these|those|they|themselves|[these|those|the] [things|ones|objects]|all of [them|these|those]|them [all|both]|"
    "both (of them|of these|of those)"
) >> (lambda: lambda context: context.they or context.it("'they'"))
COPY = "copy"
"""The name by which "the copy" is selected after "copy the dog"."""
_copy = lit("[the|its|their|his|her] [copy|copies|clone|clones|duplicate|duplicates|replica] (of it)") >> (
    lambda: _the_copy
)


def _the_copy(context: SentenceContext) -> SelectKind:
    if context.copies:
        return Named(list(context.copies)[-1])
    if len(context.earlier) > 1:
        raise Refusal("Copies were made more than once; say which is meant, for example 'the left one of' its kind.")
    if not context.earlier:
        raise Refusal("No copy was made before; say which thing is meant.")
    return next(iter(context.earlier))


_original = lit("the original (one)") >> (lambda: _the_original)


def _the_original(context: SentenceContext) -> SelectKind:
    copy = _the_copy(context)
    return context.copies[copy.name] if context.copies and isinstance(copy, Named) else context.earlier[copy]


_current = either(
    lit("(the|my|our|this) (current) selection|what [i|we|is] (have) selected|everything selected"),
    ~lit("the|my|our|this|these|those|all") + ~lit("the") + ~lit("currently") + lit("selected") + _objects,
) >> (lambda *_: lambda context: Current() if context.selected else context.it("the selection"))
_PICTURE = "scene|picture|image|video|clip|shot|footage|movie|film"
_everything = silent(
    either(
        lit("everything|all|all (of) the [things|objects]|all [things|objects]|every [object|thing]"),
        lit(
            f"(the) [whole|entire|full|complete] [{_PICTURE}|thing]|[the|this|my] [{_PICTURE}]|all of the [{_PICTURE}]"
        ),
    )
)
everything_else = lit(
    "[everything|all|anything] else|all the rest|the (whole) rest (of it|of them|of the scene|of the picture)|the others|"
    "all (the) other [things|objects|stuff]|the other [things|objects]"
) >> (lambda *_: lambda context: Not(context.it("'else'")))
_everybody_else = _everybody + lit("else") >> (
    lambda everybody: lambda context: And((everybody(context), Not(context.it("'else'"))))
)
_in_scene = ~lit(
    f"(that is|that are|which is) [in|from|of|within|inside] [the|this|my] (whole|entire) [{_PICTURE}]|out of the [{_PICTURE}]"
)
_definite = (
    either(
        everything_else,
        _everybody_else,
        _current,
        _moving,
        _static,
        _point,
        familiar,
        _determiner + _noun,
        _instance,
        _moving_noun,
        _named_at_length,
        _everything >> _always(All()),
        _it,
        _they,
        _copy,
        _original,
    )
    + _in_scene
)


def together(parts: Sequence[SelectKind]) -> SelectKind:
    """Any of the parts; neighbouring labels become one `Text`."""
    merged: list[SelectKind] = []
    for part in parts:
        before = merged[-1] if merged else None
        if isinstance(part, Text) and isinstance(before, Text) and part.number == before.number:
            merged[-1] = replace(before, labels=tuple(dict.fromkeys((*before.labels, *part.labels))))
        elif part != before:
            merged.append(part)
    return merged[0] if len(merged) == 1 else Or(tuple(merged))


def _all_of(singles: tuple[tuple[Who], ...]) -> Who:
    def who(context: SentenceContext) -> SelectKind:
        context.last = together([single(context) for (single,) in singles])
        return context.last

    return who


def _is_plural(reading: Reading, at: int) -> bool:
    return singular(reading.word(at)) != reading.word(at)


def _both(label: str, context: SentenceContext) -> SelectKind:
    select = _thing(label, plural=True)(context)
    context.last = replace(select, number="both") if isinstance(select, Text) else select
    return context.last


_and_also = lit("and|or|,|, and|, or|and also|plus|as well as|along with|together with|and then")
_single = either(_definite, _bare_stranger + _in_scene)
_both_of_them = (
    lit("both|both (of) [the|these|those|my|our|your]")
    + generated(
        lambda reading, at: ((end, label) for end, label in _known_at(reading, at) if _is_plural(reading, end - 1))
    )
    + _in_scene
) >> (lambda label: lambda context: _both(label, context))
_union = either(_both_of_them, ~lit("both|either") + listed(_single, _and_also) >> _all_of)
known_thing = ~lit("both") + listed(_definite, _and_also) >> _all_of
"""As `thing`, of a label that is known or with an article: of "look like spaghetti" nobody knows what is meant."""
_EXCEPT = (
    "except (for)|apart from|aside from|other than|excluding|besides|with the exception of|but not|without|minus|"
    "not including|but (for)"
)
_the_biggest = lit("the") + _which >> (lambda which: _one_of(which, SentenceContext.one, None))
_besides = ~lit(",") + lit(_EXCEPT) + (_union | _the_biggest)
everything_but = _everything + _in_scene + _besides
"""What is spared in "everything except the dog": a `Who`."""


def _spared(rest: Who) -> Who:
    return lambda context: Not(rest(context))


def _without(kind: Who, rest: Who) -> Who:
    def who(context: SentenceContext) -> SelectKind:
        whole = kind(context)  # first, for "the dogs except the left one"
        context.last = And((whole, Not(rest(context))))
        return context.last

    return who


thing = either(everything_but >> _spared, _union, _union + _besides >> _without)
"""Whom a command is about: a `Who`."""


def whose(quality: str) -> Rule:
    """The `Who` of "the size of the dog", "the dog's size", "its size"."""
    return either(
        ~lit("the|all|all the") + lit(quality) + lit("of|for|on|from|in") + thing,
        lit("its|their|his|her|this|that") + lit(quality) >> (lambda *_: lambda context: context.it("'its'")),
        thing + ~lit("'s|'") + lit(quality),
    )


# Which way -----------------------------------------------------------------------------------------------------------

_SIDE = "side|hand side|direction"
direction = table(
    {
        f"left|leftward|[to|toward|on] [the|its|my|your] left ({_SIDE})|more to the left|[further|farther] (to the) left": (
            -1,
            0,
            0,
        ),
        f"right|rightward|[to|toward|on] [the|its|my|your] right ({_SIDE})|more to the right|[further|farther] (to the) right": (
            1,
            0,
            0,
        ),
        "up|upward|higher|higher up|[further|farther] up|to the top": (0, -1, 0),
        "down|downward|lower|lower down|[further|farther] down|to the bottom": (0, 1, 0),
        f"[further|farther] [back|backward|away]|(further|farther) away from [{_viewer}]|away|back|backward|from [{_viewer}]|"
        "to the back|into the distance|toward the back|into the background": (0, 0, 1),
        f"forward|[closer|nearer] [to|toward] [{_viewer}]|closer|nearer|[to|toward] [{_viewer}]|to the front|into the foreground": (
            0,
            0,
            -1,
        ),
    }
)
beside = table(
    {
        "(right) [next to|beside|alongside] [it|him|her|them|itself|the original]": (1, 0, 0),
        "behind [it|him|her|them|itself|the original]": (0, 0, 1),
        "in front of [it|him|her|them|itself|the original]": (0, 0, -1),
        "above [it|him|her|them|itself|the original]": (0, -1, 0),
        "[below|under|underneath] [it|him|her|them|itself|the original]": (0, 1, 0),
        "(to the) left of [it|him|her|them|itself|the original]": (-1, 0, 0),
        "(to the) right of [it|him|her|them|itself|the original]": (1, 0, 0),
    }
)


Unit = Literal["world", "size"]


class Distance(NamedTuple):
    """A distance in `unit`."""

    value: float
    unit: Unit = "size"


Steps = tuple[tuple[Distance | None, tuple[int, int, int], Distance | None], ...]
"""(distance before, direction, distance behind) of each step of a way."""
_body = lit("size|sizes|width|widths|body width|body widths|height|length|lengths|body length|body lengths")
distance = either(
    degree >> (lambda how: Distance(0.3 if how.kind == "small" else 2.0)),
    lit("a long way|by a long way|a great distance") >> (lambda *_: Distance(2.0)),
    ~lit("by|for") + multiple + ~lit("of") + lit(ITS) + _body >> Distance,
    ~lit("by|for") + (percent + ~lit("of") + lit(ITS) + _body) >> Distance,
    ~lit("by|for") + (number | fraction) + ~lit("a|of a|of") + _body >> Distance,
    ~lit("by|for") + lit("a|its|its own|their|their own|the|his|her|one full") + _body >> (lambda *_: Distance(1.0)),
    ~lit("by|for") + number + lit("unit|units|world units|world unit") >> (lambda x: Distance(x, "world")),
    ~lit("by|for") + lit("half a unit|half of a unit") >> (lambda *_: Distance(0.5, "world")),
    lit("by") + number >> (lambda x: Distance(x, "world")),
)
_step = optional(distance) + direction + optional(distance)


steps = either(
    listed(_step, lit("and|,|, and|and then|and also")),
    beside >> (lambda way: ((None, way, None),)),
    distance + listed(_step, lit("and")) >> (lambda far, ways: (*ways[:-1], (*ways[-1][:2], far))),
)
"""`Steps` of "a bit to the left and up by 2 widths"."""


def displacement(way: Steps, far: Distance | None, default: float) -> tuple[Vector, Unit]:
    """The sum of steps along the camera's axes, and its unit; each by its own distance, the last's, `far` or the default."""
    shared = way[-1][2] or far or Distance(default)
    vector, units = [0.0, 0.0, 0.0], set()
    for before, signs, behind in way:
        one = before or behind or shared
        units.add(one.unit)
        for axis, step in enumerate(signs):
            if step and vector[axis]:
                raise Refusal("Two of the directions are on one line; say one of them.")
            vector[axis] += step * one.value
    if len(units) > 1:
        raise Refusal("One distance is in sizes and another in units of the world; use one of them.")
    return (vector[0], vector[1], vector[2]), units.pop()


# What it is called ---------------------------------------------------------------------------------------------------

_MAX_NAME_WORDS = 3


def _name_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    if reading.word(at) == '"':
        for end in range(at + 2, len(reading.tokens)):
            if reading.word(end) == '"':
                yield end + 1, reading.text_of(at + 1, end)
                return
    for end in range(at + 1, min(at + _MAX_NAME_WORDS, len(reading.tokens)) + 1):
        word = reading.word(end - 1)
        if word in FUNCTION_WORDS or not word.isalnum() or (end == at + 1 and not word.isalpha()):
            return
        yield end, reading.text_of(at, end)


name = generated(_name_at)
_no_name = either(
    _moving, _static, _current, _instance, _everybody, silent(_everything), _it, _they, _copy, _original, colour, _which
)


def means_something(called: str) -> bool:
    """Whether a name would be taken for a colour or for another way to say who: "red", "it", "everything"."""
    readings = (Reading.of(text, tokenise(text), {}) for text in (called, f"the {called}"))
    return called.lower() in FUNCTION_WORDS | NO_THINGS or any(
        len(reading.tokens) in _no_name.at(reading, 0) for reading in readings
    )
