"""How much, how far and which way: numbers, factors, degrees, distances, directions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from .degrees import DEGREES, Amount, Distance
from .grammar import (
    NOTHING,
    VOCABULARY,
    Reading,
    Rule,
    either,
    generated,
    keyword,
    listed,
    literal,
    optional,
    table,
    unless,
    word_if,
)
from .lexicon import FRACTIONS, ONES, PICTURE, TENS, word_set
from .notation import Notation
from .refusal import Mismatch

_say = Notation(globals(), VOCABULARY)
_MANY = {"hundred": 100.0, "dozen": 12.0}
_fraction_word = table(
    {
        "half|one half|a half|the half": 0.5,
        "a third|one third|the third": 1 / 3,
        "a quarter|one quarter|one fourth|a fourth": 0.25,
        "two thirds": 2 / 3,
        "three [quarters|quarter]": 0.75,
        "a fifth|one fifth": 0.2,
        "a tenth|one tenth": 0.1,
    }
)


def number_at(reading: Reading, at: int) -> Iterator[tuple[int, float]]:
    """Yield (end, number) of those that begin at a word, in digits or words, the longest first: "two", "one and a quarter"."""
    for end, whole in _counted_at(reading, at):
        if reading.word(end) == "and":
            yield from ((last, whole + part) for last, (part,) in _fraction_word.at(reading, end + 1).items())
        yield end, whole


def _counted_at(reading: Reading, at: int) -> Iterator[tuple[int, float]]:
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
        if following in _MANY:
            yield at + 2, _MANY[following] * ONES[word]
        if following == "point" and reading.word(at + 2) in ONES:
            yield at + 3, ONES[word] + ONES[reading.word(at + 2)] / 10
        yield at + 1, float(ONES[word])
    elif word in ("a", "one") and following in _MANY:
        yield at + 2, _MANY[following]
    elif word in _MANY:
        yield at + 1, _MANY[word]
    elif (word, following, reading.word(at + 2)) == ("half", "a", "dozen"):
        yield at + 3, 6.0
    elif "couple" in (word, following if word == "a" else ""):
        end = at + 1 + (word == "a")
        yield end + (reading.word(end) == "of"), 2.0


_NUMBER_WORDS = frozenset((*TENS, *ONES, *_MANY, "0", "a", "half", "couple"))
number = generated(number_at, lambda: _NUMBER_WORDS)
signed = _say("[-|minus] <number>") >> (lambda x: -x) | number
VOCABULARY.update(ONES, TENS, FRACTIONS, _MANY)

percent = _say("<number> [%|percent|per cent|pct]") >> (lambda x: x / 100)
_any_fraction = _fraction_word | generated(
    lambda reading, at: ((end, x) for end, x in number_at(reading, at) if reading.word(at + 1) == "/" and 0 < x < 1),
    lambda: frozenset("0"),
)
no_stop = unless(_say("(of) [a|an] [stop|f stop|ev]"))
"""Behind a fraction: "half a stop" is an amount of light."""
fraction = _any_fraction + no_stop
multiple = either(
    _say("<number> [times|x|fold]|x <number>"),
    table({"twice|double|doubly|two times|two fold": 2.0, "thrice|triple": 3.0, "quadruple": 4.0}),
    fraction,
)
"""A factor: "three times", "2x", "twice", "half"."""


LEAST_PERCENTS = 5
"""Numbers from this on are percents: "contrast 20", "scale 1.5"."""


_not_much = ~keyword(",") + literal(
    "(but|just) not [by much|too much|so much|that much|a lot|much|too strong|too strongly]|nothing too [strong|much|crazy|extreme]"
)
degree = _not_much >> (lambda: Amount("small")) | table(
    {
        "(just|only|by|ever so) a [tiny|wee|teeny|tiny little|teeny tiny] [bit|amount]|(just|only|by) a [hair|whisker|trifle|"
        "smidge|smidgen|smidgeon|skosh|pinch|dash|tick|fraction]|(ever) so slightly|marginally|minimally|fractionally|(just) "
        "barely|barely [noticeable|visible|there]|hardly noticeable|(by) a [wee|tiny] (bit) (more)|[just|only] a hint": Amount(
            "least"
        ),
        "(just|only|by|ever so) a [little|small|slight] [bit|amount]|(just|only|by) a [little|tad|touch|bit|notch]|slightly|"
        "mildly|somewhat|(very) [subtle|subtly|discreetly]|a bit of|(by) a little (bit) (more)|a [hint|notch|shade|"
        "step] (of it)": Amount("small"),
        "moderately": Amount("usual"),
        "much|far|way|considerably|significantly|a good deal|very much|strongly|heavily|a good bit|quite a bit|substantially|"
        "greatly|seriously|(by) a long way|a great distance": Amount("large"),
        "(quite) a lot|by a lot|a great deal|lots|a whole lot|massively|drastically|dramatically|tons|loads|heaps|miles|a [ton|"
        "load|mile|bunch|whole bunch]|by [far|miles|a mile]|enormously|hugely|vastly|radically|extremely": Amount(
            "most"
        ),
    }
)
softly = degree | table(
    {
        "softly|faintly|gently|weakly": Amount("small"),
        "intensely|brightly|very|really|badly|(even|some|a lot|much) more|stronger|harder": Amount("large"),
    }
)
"""How much of something there is: "very blurry"."""
_so_many = table({"half a": 0.5, "a|one": 1.0}) | number | _any_fraction
_part_more = _say("and <_any_fraction>")
stops = _say("<_so_many> (of a|a) [stop|stops|f stop|f stops|ev] <_part_more?>") >> (
    lambda x, more: Amount("stops", x + (more or 0))
)
"""How light is counted in cameras: each doubles it."""
_hedge = ~keyword(",") + ~literal(
    "(only|just) [about|around|roughly|approximately|like|say|maybe|some|exactly|precisely|perhaps|nearly|almost|close to|just "
    "about|at least|at most|easily|a good|only|just|no more than]"
)
_counting = literal(
    "frame|frames|f|second|seconds|s|degrees|degree|x|times|units|unit|width|widths|stop|stops|%|percent|to|-|th"
)


def _as_percents(x: float) -> Amount:
    """Return percents without their sign as a fraction; Mismatch for what may be a factor."""
    if not LEAST_PERCENTS <= x <= 100:
        raise Mismatch
    return Amount("fraction", x / 100)


percents = number >> _as_percents
amount = either(
    _say("<degree>|(by) <_hedge> <stops>"),
    _say("(by) <_hedge> [<percent>|<fraction>]") >> (lambda x: Amount("fraction", x)),
    _say("by (a) factor (of) [<multiple>|<number>]|(by) <_hedge> <multiple>") >> (lambda x: Amount("times", x)),
)


_IS = "is|are|was|were|does|do|did|has|looks"
_NOW = "now|today|at the moment|at present|presently|currently|before|originally"


def comparison(
    changed: Callable[[Amount | None, bool], Any], comparatives: str, lesser: str, positives: str, opposites: str
) -> Rule:
    """Return the rule of comparisons: "a bit bigger", "smaller by a third", "twice as big", "less big".

    `changed` makes the value of an amount and True for more; `comparatives` and `lesser` are words such as bigger and smaller,
    `positives` and `opposites` such as big and small.
    """
    compared = table({comparatives: True, lesser: False})
    plain = table({positives: True, opposites: False})
    more = either(compared, keyword("more") + plain, keyword("less") + plain >> (lambda upward: not upward))
    so = keyword("(just|about) [as|so]") + plain
    return either(
        optional(amount) + more >> changed,
        more
        + ~literal(",|-|(|:|of")
        + (amount | ~keyword("by") + _hedge + percents + unless(_counting))
        + ~literal(")")
        >> (lambda upward, how: changed(how, upward)),
        _hedge + (multiple | percent) + so >> (lambda x, upward: changed(Amount("as", x), upward)),
        fraction + (so + keyword("again") | keyword("again") + so)
        >> (lambda x, upward: changed(Amount("as", 1 + x), upward)),
    )


ITS = "[its|their|his|her|the] (own) (original|current|present|usual|former|normal|natural|regular|real|true|actual|full)|normal"


BEFORE_VERBS = word_set("and , . ; ! then please to") | {""}
"""Words behind which a verb stands that a command begins with; nothing: it is the first."""


def fraction_of(quality: str) -> Rule:
    """Return the rule of a factor: "half the size", "twice its size", "50 % of its size", "double size"."""
    noun = ~keyword("of") + ~keyword(ITS) + literal(quality) + ~literal(f"[it|he|she|they] [{_IS}] (right) ({_NOW})")
    decimal = number + keyword("of") + ~keyword(ITS) + literal(quality)
    share = either(multiple, percent, table({"quarter": 0.25, "third": 1 / 3, "full": 1.0}))
    return decimal | share + noun


# Which way -----------------------------------------------------------------------------------------------------------

VIEWER = "camera|the camera|the viewer|the lens|me|us|here"
_SIDE = "side|hand side|direction|edge|hand edge|half"
_WITHIN = ~keyword(f"of [the|this] [{PICTURE}]|in [the|this] [{PICTURE}]")


def _sideways(side: str, other: str) -> str:
    """Return phrases for the direction to one side of the picture."""
    return (
        f"(from) (the) {other} to (the) {side}|(to) [screen|camera|frame|stage] {side}|in (the) direction of (the) {side}|{side}|"
        f"{side}ward|(over|further|farther|off|out|more) [to|toward|on|at|onto|in|into] (the|its|my|your|his|her|their) (far) "
        f"{side} ({_SIDE})|more to the {side}|[further|farther|more] (to the) {side}"
    )


direction = (
    table(
        {
            _sideways("left", "right"): (-1, 0, 0),
            _sideways("right", "left"): (1, 0, 0),
            "up|upward|higher|higher up|[further|farther] up|to the top|up into the air|into the air|up in the air|off the "
            "ground|above the ground|toward the [sky|top]": (0, -1, 0),
            "down|downward|lower|lower down|[further|farther] down|to the bottom|toward the [ground|bottom]|toward the "
            "floor": (0, 1, 0),
            f"[further|farther] [back|backward|away]|(further|farther) away from [{VIEWER}]|away|back|backward|from [{VIEWER}]|"
            "to the [back|rear]|into the [distance|depth]|off into the distance|toward the back|[into|to"
            "|toward] the background|deeper (into the scene)": (0, 0, 1),
            f"(right) up [closer|close] (to) [{VIEWER}]|more [near|close] (to) [{VIEWER}]|"
            f"more [near|close]|forward|to the [foreground|fore]|[closer|nearer] [to|toward] "
            f"[{VIEWER}]|closer|nearer|[to|toward] [{VIEWER}]|to the front|into the foreground": (0, 0, -1),
        }
    )
    + _WITHIN
)
_body = keyword(
    "size|sizes|width|widths|height|heights|length|lengths|body [width|widths|length|lengths|height|heights|size|sizes]"
)
any_word = word_if(lambda reading, at: reading.word(at).isalpha())
_by = ~keyword("(with) (an|a) [offset|distance|gap|spacing] of|at a distance of|offset by|by|for") + ~literal(
    "about|around|roughly|approximately|some|like|say|maybe|nearly|almost|exactly"
)
_one = table({"a|one": 1.0})
distance = either(
    degree >> (lambda how: Distance(DEGREES[how.kind].widths)),
    _say("<_by> [<number>|<_one>] <any_word> ('s) [width|widths|height|heights|length|lengths]") >> Distance,
    _say(
        f"<_by> [<number>|<multiple>|<percent>] (of|(of) [{ITS}]|a|of a|of its own|full|[times|time] [its|his|her|their] (own)) "
        "<_body>"
    )
    >> Distance,
    _say("<_by> [a|its|its own|their|their own|the|his|her|one] (full|whole|entire) <_body>")
    >> (lambda: Distance(1.0)),
    _say("<_by> [<number>|<fraction>] (a|of a) [unit|units|world units|world unit]")
    >> (lambda x: Distance(x, "world")),
    _say("<_by> <number> [pixel|pixels|px]") >> (lambda x: Distance(x, "pixels")),
    _say(f"(right|all the way) [[out of|off (of)] (the) [{PICTURE}]|off stage|offscreen]")
    >> (lambda: Distance(1.0, "pictures")),
    _say("by <percent>") >> Distance,
    _say("by <number>") >> (lambda x: Distance(x, "world")),
)
_no_way = literal("right [now|away|here|there|after|before|from|until]")
_step = _say("<distance?> !<_no_way> <direction> <_far?>", _far=distance | percent >> Distance)


steps = listed(_step, keyword("and|,|, and|and then|and also") | NOTHING)
"""`Steps` of "a bit to the left and up by 2 widths"."""
