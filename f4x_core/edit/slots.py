"""What a command is, and the phrases that several commands share: angles, ways, delays, where a copy goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..language.amounts import distance, number, signed, steps
from ..language.degrees import Distance
from ..language.grammar import Rule, either, here, keyword, table
from ..language.lexicon import PICTURE
from ..language.refusal import Mismatch
from ..language.times import TimeExpression, duration
from .making import Value
from .phrases import beside_itself, name, place, thing


def REMARK() -> Value:  # it stands for what is said and asks for nothing
    """Make nothing: "leave the dog alone"."""
    raise Mismatch


def AGAIN() -> Value:  # likewise for the command before
    """Make what was said before: "do the same with the cat"."""
    raise Mismatch


Given = Value | tuple[tuple[Value], ...]
"""A value, or several as `listed` gives them."""


@dataclass(frozen=True)
class Use:
    """How a command may be said beside its full form."""

    bare: bool = True
    """After another command "it" may be left out: "move the dog left and turn around"."""
    whole: bool = False
    """Without a thing it is for everything: "increase the contrast"."""
    timed: bool = False
    """With a time and without a thing it is for everything: "play the last second in slow motion"."""


USUAL = Use()
NAMED = Use(bare=False)
TIMED = Use(timed=True)
WHOLE = Use(whole=True)


@dataclass(frozen=True)
class Command:
    """What may be said besides somebody and a time, and what is then done."""

    example: str
    """A sentence that uses it."""
    make: Callable[..., Given]
    """From the values of the slots to what is done."""
    slots: Mapping[str, Rule]
    """By argument name of `make`, in any order; those without a value are words that belong to the command and add nothing."""
    needed: frozenset[str] = frozenset()
    """Slots without which it means nothing."""
    who: Rule = thing
    """The phrase for whom it is about."""
    use: Use = USUAL


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
FULL_TURN = table(
    {
        "(a) half (a) [turn|rotation|spin|circle|revolution]|you turn|a 180": 180.0,
        "(a) quarter (of a) [turn|rotation|spin|circle]|(a) right angle": 90.0,
        "(a) three quarter turn|three quarters of a turn": 270.0,
        "(a|one) [full|complete|whole] [turn|circle|rotation|360|spin|revolution]|a [turn|spin|rotation]|(a) 360|full 360": 360.0,
        "two (full) [turns|rotations|spins]": 720.0,
        "three (full) [turns|rotations|spins]": 1080.0,
    },
    reserve=False,
)
_so_often = table(
    {
        "180|[halfway|half way] (around|round)": 180.0,
        "360|all the way around|once (around|completely)|around once|one [full|complete|whole] time": 360.0,
        "twice|two times": 720.0,
        "three times": 1080.0,
        "quarter": 90.0,
    },
    reserve=False,
)
_by = ~keyword("by|through|for")
ANGLE = either(
    _by + signed + keyword("degrees|degree|deg|°|º"),
    ~keyword("by") + here(lambda reading, at: reading.word(at - 1) != ":") + signed,
    _by + ~keyword("a|one") + (FULL_TURN | _so_often),
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
_lagging = keyword(
    "[delay|delayed|lag|lags|lagging|trail|trails|trailing|stagger|staggered|spaced|offset|shift|slip|push|follow|follows|following|"
    f"chase|chases|chasing|tail|tailing|shadowing|runs|walks|moves] ([behind|after]) ({_behind}|that|them) (back|late|later) "
    "([by|with|at|on the same path]) (a [delay|lag|distance] of)"
)
_coming = keyword(
    "[come|comes|coming|start|starts|starting|run|runs|running|play|plays|moves|move|moving|enter|enters|join|joins|arrive|arrives|"
    "appear|appears|go|goes|set|sets|begin|begins] (in|on|off|out|with|up) (by|with)"
)
_late = keyword(
    f"(too) [later|behind|late|after|delayed|afterward] ([than|from|behind|after] {_behind})|[after|behind] {_behind}|"
    f"in the future|"
    "offset (each)|(of) [delay|lag]|apart (each)|(in) between ((each of) [them|each (one)|the copies])|from [each "
    "other|one another]|"
    "on its path|along (its|the same) path"
)
_early = keyword("earlier|ahead|before|early|before it|in advance|ahead of [it|the original]|sooner")
_following = keyword(
    f"(that|to) [follow|trail|chase|follows|trails|chases|lags|following|trailing|lagging|chasing] [behind|after] ({_behind})|"
    f"(that|to) [follow|trail|chase|follows|trails|chases|lags|runs|walks|moves|following|trailing|lagging|chasing|"
    f"tailing|shadowing] "
    f"([behind|after]) {_behind}|that [follows|trails|lags]|follow|trail"
)
TRAIL_COPIES, TRAIL_LAG = 3.0, TimeExpression(seconds=0.2)
"""Copies of a trail, and the time from one to the next."""
SHIFT = either(
    _copies + (_lagging | keyword("with (a) ([lag|delay|gap] of)")) + duration + ~_late,
    _copies + ~_coming + ~keyword("each (one)") + duration + _late,
    _copies + ~_coming + duration + _early >> (lambda length: length.plus(length, -2.0)),
    _copies + keyword("[a bit|a little|slightly] [late|later|behind|delayed]") >> (lambda: TRAIL_LAG),
    ~keyword(",") + _following + ~keyword("on the same path") >> (lambda: TRAIL_LAG),
)
_apart = distance + keyword("apart") | ~keyword("by") + number + keyword("apart") >> Distance
BESIDE_IT: dict[str, Any] = {
    "own": beside_itself | place,
    "way": ~keyword(",") + steps,
    "far": ~keyword(",") + _apart | distance,
    "shift": SHIFT,
    "called": keyword("(,) [called|named|by the name of]") + name,
}


# What is said in passing, and commands without a verb
TOPIC = Command("the dog: make it red", REMARK, {})
QUALITY_WORDS = (
    "washed out|faded|lifeless|bland|ugly|weird|odd|bright|light|dark|dim|big|large|small|fast|slow|quick|pale|dull|"
    "colorful|saturated|warm|cold|cool|blurry|tiny|flat|gray|boring|huge|so "
    "[mid|meh|lame|basic|plain|dull|stale|tacky|dreary|drab|boring|last year|ugly|bland]"
)
