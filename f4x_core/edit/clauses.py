"""The search for what a sentence says: clauses, each a command with its slots in any order and idle words between."""
# ruff: noqa: F401  # phrases name what they are made of

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from ..language.amounts import number
from ..language.colour_names import COLOURS
from ..language.grammar import (
    NOTHING,
    VOCABULARY,
    Cover,
    Reading,
    Rule,
    covers,
    either,
    generated,
    here,
    keyword,
    listed,
    literal,
    matches_of,
    sign,
    silent,
    table,
)
from ..language.idle import EMPTY, idle_gaps
from ..language.lexicon import FUNCTION_WORDS, NO_THINGS, word_set
from ..language.notation import Notation
from ..language.refusal import Mismatch, Refusal
from ..language.times import Span, span
from ..language.verbs import COMMAND_VERBS, IMPERATIVES
from .commands import ADDS_NOTHING, COMMANDS
from .english import ABOUT_OTHERS, LEVEL, REMARK, TOPIC, Command
from .phrases import besides, known_thing, spares, thing


class Clause(NamedTuple):
    """A command with what it applies to."""

    command: Command
    slots: dict[str, Any]
    front: Span | None = None
    """A time before the command; it also holds for what follows with "and"."""
    hard: bool = False
    """It begins a sentence of its own or comes after what was said before: ". ", "then"."""
    gapped: bool = False
    """Its verb is that of the clause before: "make the dog red and [the cat blue]"."""


Clauses = tuple[Clause, ...]


_say = Notation(globals())
_then = either(span, keyword("only|just") + span, span + keyword("(,) [only|alone]"))
_when = ~keyword("(,) (but)") + _then
_slowly = ~keyword(",") + table(
    {
        "(very) slowly|gradually|gently|continuously|little by little|bit by bit|smoothly|progressively|steadily|over time|more "
        "and more|as time [goes on|goes by|passes]|with time|step by step|lerp|lerped|interpolate|interpolated|tween|tweened|"
        "keyframe|keyframed|ramp|ramped|[easy|smooth|gentle|auto] [ease|eased]|(with a) [s curve|bezier (curve)|smoothstep]|nice "
        "and [gentle|gently|easy|steady]|[with|in] a [slow|gentle|soft|smooth|gradual] [transition|ramp|blend]|(in) a gradual way|"
        "easing in|easing out|with (a) [soft|smooth|gentle] [ease|easing]|with (an) [ease|easing]|eased|(with) easing|nice and "
        "[smooth|smoothly|slow|slowly|gradual]|(nice and) smooth|(with) (a) [smooth|soft|eased] [interpolation|motion|movement|"
        "transition] ((,) not linear)": False,
        "easing in and out|with soft ends|(with) (an) ease in and out|eased in and out": True,
    }
)
"""That it comes little by little, and whether at both ends."""
_filler = silent(~listed(ADDS_NOTHING | keyword("clean up"), keyword(",") | NOTHING))
_SOFT, _HARD = (
    ", and also|, and|and also|and|as well as|, as well as|,|but|, but|plus|+|while|, while|whereas|, whereas",
    ".|;|!|then|and then|, then|, and then|afterward|, afterward|and afterward|thereafter|after that|and after that|, after that",
)
_separator = listed(table({_SOFT: False, _HARD: True}), NOTHING) >> (lambda parts: any(hard for (hard,) in parts))
_ends = silent(~listed(keyword(".|;|!|,"), NOTHING))
_about_whom = literal(
    "as [for|to|regards]|with regard to|when it comes to|in the case of|speaking of|about|regarding|concerning|focus "
    "on|concentrate on|take|select|pick|choose|click (on)|grab|go to|look at|(you) see|with|for|now"
)
_PRONOUNS = word_set("it him her them its his their they he she")
_pronoun_follows = here(lambda reading, at: any(t.text in _PRONOUNS for t in reading.tokens[at:]))
_called_out = here(lambda reading, at: reading.word(at - 1) == "!")
_do_it = here(lambda reading, at: reading.word(at) in IMPERATIVES and reading.word(at + 1) in _PRONOUNS)
_topic_before = _say(
    "<_about_whom> <thing> [<_do_it>|,|:|and|-|.]|<thing> [:|[,|-|->|=>|=|!] [<_pronoun_follows>|<_called_out>]]"
) >> (lambda who: Clause(TOPIC, {"who": who}))
_bracket = sign(")")
_number_of_item = _say("(step|item|edit|no|#) <.number> [<_bracket>|.|:]")
_separator_or_number = _say.table({"<_separator> (<_number_of_item>)": lambda hard: hard, "<_number_of_item>": True})


def _heading_at(reading: Reading, at: int) -> Iterator[tuple[int, None]]:
    """Yield the end of a note's heading, which names no thing: "grade: "."""
    end = next((end for end in range(at + 1, at + 1 + _MAX_HEADING) if reading.word(end) == ":"), None)
    words = set(reading.words[at:end])
    if end is not None and words <= (VOCABULARY | NO_THINGS) - COLOURS.keys() and not span.at(reading, at):
        yield end + 1, None


_MAX_HEADING = 2
"""Words of a heading."""
_start = _say(
    "(and|while|as) <_ends> (<_number_of_item>) (first|to begin with|to start with|for starters) <_topic?>",
    _topic=either(_filler + _topic_before, generated(_heading_at)),
)
_ONE_MORE, _RUN_ON, _IN_FRONT = 2, 7, 0.1
"""Costs of a command behind another, and of one with nothing between; what a time before a command is better than one within."""
_JOINING = EMPTY | word_set("also too then just now please only")
"""Words before the verb of a clause."""
_any_order: list[tuple[Command, dict[str, Rule], frozenset[str]]] = [
    (
        command,
        {"who": command.who, **command.slots, "when": _when, "slowly": _slowly, "besides": besides, "spares": spares},
        command.needed | (frozenset() if command.use.bare or command.use.whole else {"who"}),
    )
    for command in COMMANDS
]
"""Commands, their slots, which stand in any order with idle words between, and those without which they are not meant."""
_front = span + ~keyword(",|:")


class Found(NamedTuple):
    """A clause, or several, and what their idle words cost."""

    cost: float
    clauses: Clauses
    idle: tuple[int, ...] = ()


class Search:
    """The ways to read a sentence, with idle words between its phrases."""

    def __init__(self, reading: Reading, known: Collection[str]):
        """Match all commands on the sentence; `known` holds the last words of the scene's labels."""
        self.reading, self.end = reading, len(reading.tokens)
        self.gaps = idle_gaps(reading, ADDS_NOTHING, known, COMMAND_VERBS)
        self.commands = [
            (order, command, needed, matches)
            for order, (command, slots, needed) in enumerate(_any_order)
            if id(command) not in reading.barred and (matches := matches_of(slots, command.needed, reading))
        ]
        self.at: dict[tuple[int, int], dict[int, Found]] = {}

    def _clauses(self, start: int, before: Clause | None) -> dict[int, Found]:
        """Return the cheapest clause from word `start` to each later word; its verb may be that of the clause `before`."""
        key = start, id(before and before.command)
        complained = before and before.command.make is REMARK and "complaint" in before.slots
        if key in self.at:
            return self.at[key]
        best = self.at[key] = {}
        for order, command, needed, matches in self.commands:
            if command.make is LEVEL and not complained:
                continue
            ways: list[dict[str, Any]] = [{}]
            if before and command is before.command:  # what need not be said again
                ways += [
                    {name: before.slots[name]}
                    for name in ("verb", "quality")
                    if name in command.needed & before.slots.keys()
                ]
            for given in ways:
                price = order / 500 + ("verb" in given)
                for end, found in covers(matches, needed - given.keys(), self.gaps, start).items():
                    limit = best[end].cost - price if end in best else math.inf
                    if fitting := _first_made(found, limit, command, given, needed):
                        slots = {**given, **fitting.values}
                        best[end] = Found(fitting.cost + price, (Clause(command, slots),), fitting.idle)
        return best

    def _next(self, begin: int, before: Clause | None) -> Iterator[tuple[int, int, Found]]:
        """Yield (first word, end, clause) of each clause from word `begin` on, with or without a time in front."""
        yield from ((begin, end, found) for end, found in self._clauses(begin, before).items())
        for start, (front,) in _front.at(self.reading, begin).items():
            for end, found in self._clauses(start, before).items():
                clause = found.clauses[0]._replace(front=front)
                twice = "when" in clause.slots and (front.kind, clause.slots["when"].kind) != ("moment", "length")
                cost = found.cost + (_ONE_MORE if twice else -_IN_FRONT)
                yield start, end, Found(cost, (clause,), found.idle)

    def _is_gapped(self, start: int) -> bool:
        """Return True if a clause begins with no verb."""
        words = (word for word in self.reading.words[start:] if word not in _JOINING)
        return next(words) not in COMMAND_VERBS

    def sentence(self) -> Found | None:
        """Return the cheapest reading of the whole sentence; None where there is none."""
        best: dict[int, Found] = {}
        for end, (topic,) in _start.at(self.reading, 0).items():
            best[end] = Found(0, () if topic is None else (topic,))
        for at in range(self.end):
            if at not in best:
                continue
            done = best[at]
            starts: dict[int, tuple[float, bool]] = {at: (0, False)}
            if _commands(done):
                starts = {at: (_RUN_ON, False)}
                starts |= {e: (_ONE_MORE, hard) for e, (hard,) in _separator_or_number.at(self.reading, at).items()}
            for begin, (price, hard) in starts.items():
                for start, end, (cost, (clause,), idle) in self._next(
                    begin, done.clauses[-1] if _commands(done) else None
                ):
                    cost += done.cost + price
                    topic_alone = (
                        done.clauses and not _commands(done) and _PRONOUNS.isdisjoint(self.reading.words[start:end])
                    )
                    if topic_alone and "who" in clause.slots and "verb" not in clause.slots:
                        cost += _ONE_MORE  # "hills: snow white" is about the hills
                    if price == _RUN_ON and not (
                        (self.reading.word(start) in IMPERATIVES or known_thing.at(self.reading, start))
                        and "who" in clause.slots
                        and "who" in done.clauses[-1].slots
                    ):
                        continue
                    if end not in best or cost < best[end].cost:
                        gapped = _commands(done) and not hard and clause.front is None and self._is_gapped(start)
                        clause = clause._replace(hard=hard, gapped=gapped)
                        best[end] = Found(cost, (*done.clauses, clause), done.idle + idle)
        whole = [found for at, found in best.items() if self.end in _ends.at(self.reading, at) and _commands(found)]
        return min(whole, key=lambda found: found.cost, default=None)


def _first_made(
    found: Collection[Cover], limit: float, command: Command, given: dict[str, Any], needed: frozenset[str]
) -> Cover | None:
    """Return the first of `found`, which are sorted by cost, that costs less than `limit` and whose values fit the command."""
    for cover in found:
        if cover.cost >= limit:
            return None
        # "And the cat" alone says no more than whom and belongs to the clause before it.
        more = not given or cover.values.keys() & ((needed | {"when", "way"}) - {"verb", "who"})
        if more and _can_be_made(command, {**given, **cover.values}):
            return cover
    return None


def _commands(found: Found) -> bool:
    """Return True if there is a clause that is no mere topic."""
    return any(clause.command is not TOPIC for clause in found.clauses)


def _can_be_made(command: Command, filled: dict[str, Any]) -> bool:
    """Return True if the values of a command go together."""
    if command.make in ABOUT_OTHERS:
        return not {"nothing", "when"} <= filled.keys()  # "and let it run again at second 2" asks for something
    with suppress(Refusal, Mismatch):
        command.make(**arguments(filled))
        return True
    return False


OF_ALL = ("who", "when", "slowly", "besides", "spares")
"""Slots that every command has."""


def arguments(piece: Mapping[str, Any]) -> dict[str, Any]:
    """Return the slots of a clause that are arguments of its command."""
    return {name: value for name, value in piece.items() if name not in OF_ALL and value is not None}
