"""The words and rules that operations say their sentences in: those of the language, of things and times, and what commands share.

An operation imports this in `sentences`, under the name `say`.
"""
# ruff: noqa: F401, I001

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..language.amounts import (
    BEFORE_VERBS,
    amount,
    comparison,
    degree,
    distance,
    fraction,
    fraction_of,
    multiple,
    number,
)
from ..language.amounts import percent, signed, softly, steps, stops
from ..language.colours import colour, colourish, more_colour
from ..language.degrees import DEGREES, Amount, Distance
from ..language.grammar import Rule, constant, either, here, keyword, literal
from ..language.grammar import optional, silent, table, unless
from ..language.lexicon import PICTURE, every_form, word_set
from ..language.notation import Notation
from ..language.refusal import Mismatch
from ..language.times import TimeExpression, duration, span
from ..language.verbs import IMPERATIVES, any_form, asked_form
from .phrases import SentenceContext, beside_itself, everything_but, familiar, known_noun, known_thing, name, place
from .phrases import there_already, thing, two_of_them, who_of, whose
from .selects import All, SelectKind
from .values import Given, Graded, Value

if TYPE_CHECKING:
    from .change import Change
    from .phrases import When


def REMARK() -> Value:  # it stands for what is said and asks for nothing
    """Make nothing: "leave the dog alone"."""
    raise Mismatch


def AGAIN() -> Value:  # likewise for the command before
    """Make what was said before: "do the same with the cat"."""
    raise Mismatch


def LEVEL() -> Value:  # likewise for the quality that is complained of
    """Make more or less of it: "too bright, take it down 20 %"."""
    raise Mismatch


ABOUT_OTHERS = (REMARK, AGAIN, LEVEL)
"""What makes nothing by itself."""


@dataclass(frozen=True)
class Use:
    """Forms of a command besides its full one."""

    bare: bool = True
    """After another command "it" may be left out: "move the dog left and turn around"."""
    whole: bool = False
    """Without a thing it is for everything: "increase the contrast"."""
    alone: bool = False
    """It is about no thing: "undo that"."""
    timed: bool = False
    """With a time and without a thing it is for everything: "play the last second in slow motion"."""


USUAL = Use()
NAMED = Use(bare=False)
TIMED = Use(timed=True)
WHOLE = Use(whole=True)


about = ~literal("of|for|on|to|in|with|around|round|about|onto|over|at|from|upon|into|through|across|all over")
_SEEN_ALONE = word_set("visible seen shown left remain remaining remains there")
_not_seen_alone = here(lambda reading, at: _SEEN_ALONE.isdisjoint(reading.words))
"""Of "only the dog should be visible" the rest is not to be seen."""
phrase = Notation(globals())
"""The rule of a phrase in words, which may name rules of this module."""
whom = phrase(
    "![over the [clip|video|film|scene|shot]|across the board] (<_not_seen_alone> (but) [only|just|only for|just for|only with]) "
    "<about> <thing> (only|alone)"
)
"""Whom a command is about, with what may stand before and behind."""


@dataclass(frozen=True)
class Command:
    """The slots of a command besides its target and time, and the value that they make."""

    example: str
    """A sentence that uses it."""
    make: Callable[..., Given]
    """From the values of the slots to what is done."""
    needed: frozenset[str]
    """Slots without which it means nothing."""
    slots: Mapping[str, Rule]
    """By argument name of `make`, in any order; those without a value are words that belong to the command and add nothing."""
    who: Rule = whom
    """The phrase for whom it is about."""
    use: Use = USUAL


def command(
    example: str, make: Callable[..., Given], needed: str, use: Use = USUAL, who: Rule | str = whom, **slots: Any
) -> Command:
    """Return a command; its slots are written in the notation of `phrase`, or as a table of words and values."""
    rules = {
        name: table(rule, reserve=False) if isinstance(rule, dict) else phrase(rule) for name, rule in slots.items()
    }
    return Command(example, make, frozenset(needed.split()), rules, phrase(who), use)


@dataclass(frozen=True)
class Quality:
    """Something that there is more or less of. Words are alternatives with `|`."""

    changed: Graded
    """The value for an amount more or less of it."""
    more: str
    """"brighter"."""
    less: str
    """"darker"."""
    much: str
    """"bright", which also stands behind "more", "less", "as", "too" and "not"."""
    little: str
    """"dark", likewise."""
    noun: str
    """"brightness"."""
    lack: str = ""
    """"darkness"."""
    up: str = ""
    """Sense of `language.verbs` of making more of it."""
    down: str = ""
    """And less."""
    excess: str = ""
    """Adjectives for too much of it: "overexposed"."""
    dearth: str = ""
    """And too little: "murky"."""
    too: str = ""
    """More words behind "too": "shiny"."""
    too_little: str = ""
    """And for too little: "shadowy"."""
    sets: str = ""
    """Sense of what brings it to a value: "scale the dog to 80 %"."""
    bare: bool | None = None
    """`much`, or else `little`, says by itself that it gets so: "a bit blurry", "30 % transparent"."""
    wished: bool = False
    """So do both where they are wished for: "the sand should be dark"."""

    @property
    def at_most_all(self) -> bool:
        """Return True if there is no more of it than all: "raise the opacity to 80 %"."""
        return self.bare is False

    @property
    def value(self) -> Rule:
        """The value: "brighter by a third", "twice as bright", "half the brightness"."""
        compared = comparison(self.changed, self.more, self.less, self.much, self.little)
        rules = [compared, fraction_of(self.noun) >> self.times]
        if self.bare is not None:
            word, how = keyword(self.much if self.bare else self.little), softly | amount
            rules += [rule >> self._becomes for rule in (optional(how) + word, word + how)]
        return either(*rules)

    def _becomes(self, how: Amount | None) -> Value:
        return self.changed(how, bool(self.bare))

    def times(self, by: float) -> Value:
        """Return the value for `by` times the quality; Mismatch for 1."""
        if by == 1:
            raise Mismatch  # "in full color" asks for no more or less of it
        return self.changed(Amount("as", by), True)

    def complaints(self) -> Iterator[tuple[str, str, bool]]:
        """Yield (words behind "too", words that complain by themselves, True where more of it helps)."""
        nouns = self.noun.split("|")
        yield "|".join((self.much, self.too, *(f"much {noun}" for noun in nouns))), self.excess, False
        yield "|".join((self.little, self.too_little, *(f"little {noun}" for noun in nouns))), self.dearth, True

    def helps(self, upward: bool) -> Value | None:
        """Return the value for more or less of the quality; None where there is none."""
        try:
            self.changed(None, upward)
        except Mismatch:
            return None
        return Remedy(self.changed, upward)


@dataclass(frozen=True)
class Remedy:
    """The value against too much or too little of a quality, as much as is usual where nobody says more."""

    changed: Graded
    upward: bool
    """More of it helps."""

    def __call__(self, who: SelectKind, when: When, context: SentenceContext) -> Change:
        """Make the usual change."""
        return self.changed(None, self.upward)(who, when, context)


@dataclass(frozen=True)
class Sentences:
    """The sentences that ask for an operation."""

    commands: tuple[Command, ...] = ()
    """In the order in which they are preferred."""
    qualities: tuple[Quality, ...] = ()
    """Qualities that it changes."""
    made: tuple[Rule, ...] = ()
    """Values after "make the dog", such as "red"."""
    alone: tuple[Rule, ...] = ()
    """Values that stand there as they are, without "to", "in" or "more"."""
    verbs: Mapping[str, tuple[Graded, bool | None]] = field(default_factory=dict)
    """Sense of a verb -> what it makes more of, or less."""
    too: Mapping[str, tuple[Value | None, Value | None]] = field(default_factory=dict)
    """Quality -> what is done where there is too much of it, and where there is not enough."""
    early: tuple[Command, ...] = ()
    """Commands that are preferred to those of qualities."""
    given: tuple[Rule, ...] = ()
    """Values that are preferred to those in `made`."""


def always(value: Value) -> Callable[[], Value]:
    """Make the same value, whatever is said besides."""
    return lambda: value


def as_given(values: Given) -> Given:
    """Make the values themselves of a slot `values`."""
    return values


OUT = keyword(
    f"out|away|off|[off|out of|away from] [the|this|my|our] (whole|entire) [{PICTURE}]|out of [there|here|sight]|from "
    f"[sight|view]|from [the|this|my|our] (whole|entire) [{PICTURE}]"
)

# Moving and turning
SENSE = table(
    {
        "(over) (to|toward|on|into) (the|its|his|her|their) left (side|hand side)|leftward|counterclockwise"
        "|counter clockwise|anticlockwise|anti clockwise": -1,
        "(over) (to|toward|on|into) (the|its|his|her|their) right (side|hand side)|rightward|clockwise": 1,
    }
)
_so_often = table(
    {
        "(a) half (a) [turn|rotation|spin|circle|revolution]|you turn|(a) 180|[halfway|half way] (around|round)": 180.0,
        "(a) quarter (of a) [turn|rotation|spin|circle]|quarter|(a) right angle": 90.0,
        "(a) three quarter turn|three quarters of a turn": 270.0,
        "(a|one) [full|complete|whole] [turn|circle|rotation|360|spin|revolution|time]|a [turn|spin|rotation]|(a|full) 360|all the "
        "way around|once (around|completely)|around once": 360.0,
        "two (full) [turns|rotations|spins]|twice|two times": 720.0,
        "three (full) [turns|rotations|spins]|three times": 1080.0,
    },
    reserve=False,
)
_by = ~keyword("by|through|for")
ANGLE = either(
    _by + signed + keyword("degrees|degree|deg|°|º"),
    ~keyword("by") + here(lambda reading, at: reading.word(at - 1) != ":") + signed,
    _by + ~keyword("a|one") + _so_often,
)
# Copies
_copies = ~keyword(
    "(,) (please ,) (and|but|with|while|that|which|who|by) ([each|every|both] (one) (of them)|[he|she|it|they|the copy|the copies|"
    "all] (of them)|that) (is|are|being|to be)"
)
_behind = (
    "[it|him|her|itself|the original|the first (one)|the real one|the other (one)|the [one|copy|last|previous] (one) "
    "([before|ahead] (of) (it|that))]"
)
_lagging = every_form("follow|trail|chase|lag|tail")
_coming = keyword(
    f"(that|to) [{_lagging}|{every_form('come|start|run|play|move|walk|enter|join|arrive|appear|go|set|begin')}|delay|delayed|"
    f"stagger|staggered|spaced|offset|shift|slip|push] ([behind|after]) ({_behind}|that|them) (in|on|off|out|up|back|late|later) "
    "([by|with|at|on the same path]) (a [delay|lag|distance] of)|with (a) ([lag|delay|gap] of)"
)
_late = keyword(
    f"(too) [later|behind|late|after|delayed|afterward] ([than|from|behind|after] {_behind})|[after|behind] {_behind}|"
    "in the future|offset (each)|(of) [delay|lag]|apart (each)|(in) between ((each of) [them|each (one)|the copies])|from [each "
    "other|one another]|on its path|along (its|the same) path"
)
_following = keyword(
    f"(that|to) [{_lagging}|runs|walks|moves] ([behind|after]) {_behind}|(that|to) [{_lagging}] [behind|after]|that [{_lagging}]|"
    "follow|trail"
)
TRAIL_COPIES, TRAIL_LAG = 3.0, TimeExpression(seconds=0.2)
"""Copies of a trail, and the time from one to the next."""
SHIFT = either(
    _copies + _coming + duration + ~_late,
    _copies + ~keyword("each (one)") + duration + _late,
    _copies + keyword("[a bit|a little|slightly] [late|later|behind|delayed]") >> (lambda: TRAIL_LAG),
    ~keyword(",") + _following + ~keyword("on the same path") >> (lambda: TRAIL_LAG),
)
_apart = distance + keyword("apart") | ~keyword("by") + number + keyword("apart") >> Distance
BESIDE_IT: dict[str, Any] = {
    "own": beside_itself | place,
    "way": ~keyword(",") + steps,
    "far": ~keyword("(,) ([spaced|separated] (out) ([by|at])|with (a) [spacing|gap] of|at intervals of)")
    + (_apart | distance),
    "shift": SHIFT,
    "called": keyword("(,) [called|named|by the name of]") + name,
}


# What is said in passing, and commands without a verb
TOPIC = Command("the dog: make it red", REMARK, frozenset(), {})
QUALITY_WORDS = (
    "washed out|faded|lifeless|bland|ugly|weird|odd|bright|light|dark|dim|big|large|small|fast|slow|quick|pale|dull|"
    "colorful|saturated|warm|cold|cool|blurry|tiny|flat|gray|boring|huge|so "
    "[mid|meh|lame|basic|plain|dull|stale|tacky|dreary|drab|boring|last year|ugly|bland]"
)

# What colors, lights and looks share
shade_of = ~keyword(
    "(nice|lovely|bright|strong|warm|cool) [shade|tone|tint|hue] of|any [shade|tone] of|nice|lovely|beautiful|pretty|"
    "kind of|really|very|warm|cool|soft|rich|strong|plain"
) + ~literal(
    "vivid|fluorescent|shiny|glossy|matte|metallic|intense|gorgeous|fresh|proper|real|true|good old|super|bold|juicy|loud|"
    "screaming|striking|deep and rich|electric|luminous|total|totally|all|autumn|fire|fire engine|blood|cherry|ice|icy|baby|"
    "grass|lemon|canary|candy|coal|jet|snow|brick|emerald|ruby|ocean|cobalt|rose|bottle|mustard|strawberry|burnt|crimson|cute"
)
colored = ~keyword("(in) color|colored|tone") + unless(keyword("tint|filter"))
effect = keyword(
    "colors|palette|look|style|effect|filter|appearance|finish|feel|vibe|vibes|mood|tone|tones|light|coloring|treatment|"
    "feeling|grade"
) | literal("statue|sculpture|figurine|atmosphere|version|theme|aesthetic|paint|coat")
a_bit = ~literal("some|a|an|a bit of|a little|a touch of|the") + optional(
    table(
        {
            "(very) [slight|soft|light|gentle|little|subtle|small|faint|tiny|mild]|touch of|hint of|bit of": Amount(
                "small"
            ),
            "(very) [strong|heavy|thick|bright|intense|big|huge|hard|massive]|lot of": Amount("large"),
        },
        reserve=False,
    )
)
"""Amount of something that is put on a thing."""
LIGHT_VERBS = any_form("become", "apply", "leave")
"""Verbs that only carry what a noun or a value says: "stick a glow on it", "trim the contrast to 80 %"."""
over = here(lambda reading, at: not reading.word(at).isalpha())
has_to_go = literal("go|goes|gone") + over
light_verb = literal(LIGHT_VERBS)
SEEM = "look|looking|looks|looked|appear|seem|feel"
REAL = "a|an|some|the|pure|that|this|made of|made out of|in|being|real"
a_ = ~literal("(with|in|of|to|into) (a|an|some|the|that|this)")
slight = literal("slight|faint|light|soft|subtle|little|tiny|gentle|hint of|touch of|bit of|dash of|little bit of")
a_color = a_ + ~slight
toward = ~literal(
    "[up|down] to|something like|something in|a kind of|more of|(look|looks) like (an|some) old [movie|film|photo|photograph|"
    "picture|postcard] (,) (in)|in|to|into|as|with|at|by|toward|of|being|it|them|more like|like|rather|old film|vintage|old|"
    "classic|nice|some|for|but|but in|be of|from"
)


def at_most(x: float) -> float:
    """Return a fraction unchanged; Mismatch above 1."""
    if x > 1:
        raise Mismatch
    return x


at_most_all = degree >> (lambda how: min(1.0, DEGREES[how.kind].share)) | percent >> at_most
"""A part of the usual strength, or all of it."""


nobody = table({})
"""No words: of a command that is about no thing."""


@who_of
def the_clip(context: SentenceContext) -> SelectKind:
    """Return everything, which a clip, its time or its action stand for, and remember it as what was named last."""
    context.last = All()
    return context.last
