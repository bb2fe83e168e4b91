"""Words of a sentence, and rules that match them: small parser combinators that keep every way to go on.

A rule asked at a word answers with the ways it can match there: `{word after the match: values}`, the preferred way first. Each
(rule, word) is worked out once per sentence, and one way per end is kept, so the time is polynomial whatever is typed.
Rules are joined as in `the + colour | number`; `~rule` may be absent; `rule >> function` makes one value of the values matched.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from itertools import count
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar

from .lexicon import CONTRACTIONS, SPELLING
from .refusal import Doubt, Mismatch, Slip

Meaning = TypeVar("Meaning")
Ways = dict[int, tuple[Any, ...]]
"""End of a match -> its values; the first is the preferred one."""

_TOKEN = re.compile(r"<?[-=]>|#[0-9a-f]{6}\b|#[0-9a-f]{3}\b|\d+(?:\.\d+)?|\.\d+|[^\W\d_]+(?:'[^\W\d_]+)?|\S")
_RANGE = re.compile(r"(?<=[a-z])(?<!\d[a-z])-(?=[a-z])")
"""A hyphen inside a word: it joins words ("see-through"); behind a number it is a minus or "to" ("2s-end")."""


@dataclass(frozen=True)
class Token:
    """A word, number or sign."""

    text: str
    """Lower case, in American spelling."""
    start: int
    """First character in the sentence."""
    end: int
    """Behind the last one."""

    @property
    def is_word(self) -> bool:
        """Letters alone."""
        return self.text.isalpha()


def tokenise(sentence: str) -> list[Token]:
    """Return the tokens of a sentence; contractions are taken apart ("don't": do, not; "dog's": dog, 's)."""
    lowered = sentence.lower()
    if len(lowered) != len(sentence):  # a letter whose small form is longer would shift every place behind it
        lowered = "".join(c.lower() if len(c.lower()) == 1 else c for c in sentence)
    lowered = lowered.translate(_PLAIN)
    tokens: list[Token] = []
    for match in _TOKEN.finditer(_RANGE.sub(" ", lowered)):
        text, start, end = match.group(), match.start(), match.end()
        if ("'" not in text or len(text) == 1) and text not in CONTRACTIONS:
            tokens.append(Token(SPELLING.get(text, text), start, end))
            continue
        parts = CONTRACTIONS.get(text)
        if parts:
            tokens += [Token(part, start, end) for part in parts]
        else:
            cut = text.index("'")
            tokens += [Token(text[:cut], start, start + cut), Token(text[cut:], start + cut, end)]
    return tokens


@lru_cache(4096)  # of the everyday words, which most scenes have
def words_of_label(label: str) -> tuple[str, ...]:
    """Return the tokens of a label or name."""
    return tuple(token.text for token in tokenise(label))


_PLAIN = str.maketrans("’‘`“”–—−×→➜⇒\n", "'''\"\"---x===;")
"""Typographic signs -> plain ones; a line break ends a sentence."""
_MOST_AHEAD = 40
"""Words behind the last one that rules may look at."""


@dataclass
class Reading:
    """A sentence that is being matched."""

    sentence: str
    known: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    """Words of a label or name -> as it is spelled."""
    tokens: list[Token] = field(default_factory=list)
    """Those that are matched; none: all of the sentence."""
    memo: dict[int, Ways] = field(default_factory=dict)
    """Number of a rule plus a word -> the ways to match it there."""
    places: dict[int, dict[int, list[tuple[int, Any]]]] = field(default_factory=dict)
    """Number of a rule that is a slot -> where it matches."""
    barred: frozenset[int] = frozenset()
    """Ids of the commands that are not asked, because what they made of the sentence cannot be."""
    longest: int = field(init=False)
    """Words of the longest label or name."""
    words: list[str] = field(init=False)
    """Texts of the tokens, and nothing behind them."""
    openers: list[str] = field(init=False)
    """The same as `opener` has them."""

    def __post_init__(self) -> None:
        """List the words."""
        self.tokens = self.tokens or tokenise(self.sentence)
        self.longest = max(map(len, self.known), default=1)
        self.words = [token.text for token in self.tokens] + [""] * (_MOST_AHEAD + 1)
        self.openers = list(map(opener, self.words))

    def word(self, at: int) -> str:
        """Return the text of the token at an index; empty behind the last."""
        return self.words[at] if at < len(self.words) else ""

    def text_of(self, start: int, end: int) -> str:
        """Return tokens [start, end) as the person typed them."""
        return " ".join(self.sentence[self.tokens[start].start : self.tokens[end - 1].end].split())


def opener(word: str) -> str:
    """Return the key by which rules are found: "0" for a number in digits, "#" for a color in digits, else the word."""
    if word[:1].isdecimal() or (word[:1] == "." and len(word) > 1):
        return "0"
    return "#" if word[:1] == "#" else word


_NUMBERS = count(step=1 << 20)
"""Numbers of rules, farther apart than a sentence has words."""


class Rule:
    """Something that can be matched at a word."""

    def __init__(
        self,
        match: Callable[[Reading, int], Ways],
        first_words: Callable[[], frozenset[str] | None] = lambda: None,
        may_be_empty: bool = False,
    ):
        """Hold the function that matches; `first_words` makes `first`, when that is first needed."""
        self.match, self._first_words, self.may_be_empty, self.number = match, first_words, may_be_empty, next(_NUMBERS)

    @cached_property
    def first(self) -> frozenset[str] | None:
        """The words, as `opener` has them, that every match of a word or more begins with; None where that is not known."""
        return self._first_words()

    @cached_property
    def opening(self) -> frozenset[str] | None:
        """The words at which it can match at all; None where that may be at any."""
        return None if self.may_be_empty else self.first

    def at(self, reading: Reading, at: int) -> Ways:
        """Return the ways to match at word `at`, best first."""
        opening = self.opening
        if opening is not None and reading.openers[at] not in opening:  # most, at most words
            return {}
        memo, key = reading.memo, self.number + at
        ways = memo.get(key)
        if ways is None:
            memo[key] = {}  # a rule that asks for itself at the same word has no match there
            ways = memo[key] = self.match(reading, at)
        return ways

    def __add__(self, other: Rule) -> Rule:
        """Return the rule of both, one after the other."""

        def match(reading: Reading, at: int) -> Ways:
            ways: Ways = {}
            for middle, values in self.at(reading, at).items():
                for end, more in other.at(reading, middle).items():
                    if end not in ways:
                        ways[end] = values + more
            return ways

        first = [self, other] if self.may_be_empty else [self]
        return Rule(match, lambda: _any_of(first), self.may_be_empty and other.may_be_empty)

    def __or__(self, other: Rule) -> Rule:
        """Return the rule of either; this one is preferred."""
        return either(self, other)

    def __invert__(self) -> Rule:
        """Return the rule of this or nothing."""

        def match(reading: Reading, at: int) -> Ways:
            ways = self.at(reading, at)
            return ways if at in ways else {**ways, at: ()}

        return Rule(match, lambda: self.first, True)

    def __rshift__(self, function: Callable[..., Any]) -> Rule:
        """Return the rule with one value, `function` of its values; where that raises `Mismatch`, there is no match."""

        def match(reading: Reading, at: int) -> Ways:
            ways: Ways = {}
            for end, values in self.at(reading, at).items():
                try:
                    ways[end] = (function(*values),)
                except Mismatch:
                    continue
            return ways

        return Rule(match, lambda: self.first, self.may_be_empty)


def read_as_meant(read: Callable[[str], Meaning], sentence: str, agreed: bool) -> tuple[Meaning, tuple[str, ...]]:
    """Return what `read` makes of a sentence, or of what it probably means, and a line for people for each change to it.

    Slips are mended; other doubts where it is `agreed`, and else `Doubt` is raised.
    """
    notes: tuple[str, ...] = ()
    while True:
        try:
            return read(sentence), notes
        except Doubt as doubt:  # each round knows one word more
            if not (agreed or isinstance(doubt, Slip)):
                raise
            sentence, notes = doubt.instead, (*notes, f"Read as '{doubt.instead}'.")


VOCABULARY: set[str] = set()
"""Every word of the grammar itself: none of them is taken for a thing."""
NAMES_TOO: set[str] = set()
"""Words of the grammar that may be names of things as well."""


def table(entries: Mapping[str, Any], *, reserve: bool = True, vocabulary: set[str] | None = None) -> Rule:
    """Return the rule of the phrases in a table, longer ones preferred, with their values.

    A key holds alternatives with `|`; of `[some|words]` one stands there, of `(some|words)` one or none. `reserve`: its words are
    no names of things; `vocabulary`: where they go to, else `VOCABULARY` or `NAMES_TOO`.
    """
    if vocabulary is None:
        vocabulary = VOCABULARY if reserve else NAMES_TOO
    for spec in entries:
        vocabulary.update(_WORD.findall(spec))
    rows = _Table(entries)
    return Rule(rows.match, rows.first_words)


class _Table:
    """Phrases with their values. They are read at first use: most sentences need few of the two thousand tables."""

    def __init__(self, entries: Mapping[str, Any]):
        self.entries = entries

    @cached_property
    def rows(self) -> dict[str, list[tuple[Phrase, Any]]]:
        """First word -> (phrase, its values)."""
        return _by_first_word(
            (_phrase(one), () if value is None else (value,))
            for spec, value in self.entries.items()
            for one in split(spec)
        )

    def first_words(self) -> frozenset[str]:
        """Return the words that some phrase begins with."""
        return frozenset(map(opener, self.rows))

    def match(self, reading: Reading, at: int) -> Ways:
        """Return the ends of the phrases at word `at`, the last first, each with the value of the first entry that has it."""
        ways: Ways = {}
        for phrase, values in self.rows.get(reading.words[at], ()):
            for end in _ends(phrase, reading, at):
                ways.setdefault(end, values)
        return dict(sorted(ways.items(), reverse=True)) if len(ways) > 1 else ways


def keyword(spec: str) -> Rule:
    """Return the rule of phrases without a value; their words name nothing elsewhere."""
    return table({spec: None})


def literal(spec: str) -> Rule:
    """Return the rule of phrases without a value; their words may be names of things elsewhere."""
    return table({spec: None}, reserve=False)


def sign(text: str) -> Rule:
    """Return the rule of a sign that would be a bracket in `keyword`."""
    return word_if(lambda reading, at: reading.word(at) == text)


def word_if(condition: Callable[[Reading, int], Any]) -> Rule:
    """Return the rule of one word for which a condition holds."""
    return Rule(lambda reading, at: {at + 1: ()} if condition(reading, at) else {})


def split(spec: str, at: str = "|") -> list[str]:
    """Split `spec` at the signs `at` that are in no bracket; with `|` the parts are alternatives."""
    if "(" not in spec and "[" not in spec:
        return spec.split(at)
    parts, depth = [""], 0
    for piece in re.split(rf"([][()]|{re.escape(at)})", spec):
        depth += (piece in ("(", "[")) - (piece in (")", "]"))
        if piece == at and not depth:
            parts.append("")
        else:
            parts[-1] += piece
    return parts


_WORD = re.compile(r"[^][()|\s]+")


class Bracket(NamedTuple):
    """One of the phrases in a bracket, or perhaps none."""

    phrases: Mapping[str, Sequence[tuple[Phrase, Any]]]
    """By first word."""
    may_be_empty: bool


Phrase = tuple[str | Bracket, ...]
"""Words and brackets, one after the other. They are matched as they are: one phrase may stand for a million word sequences."""


def _phrase(spec: str) -> Phrase:
    """Return the phrase that is written "to (the|my) left"."""
    return tuple(_bracket(part) if part[0] in "([" else part for part in split(spec, " ") if part)


@cache
def _bracket(spec: str) -> Bracket:
    """Return the bracket that is written "[some|words]" or "(some|words)"."""
    return Bracket(_by_first_word((_phrase(one), ()) for one in split(spec[1:-1])), spec[0] == "(")


def _by_first_word(rows: Iterable[tuple[Phrase, Any]]) -> dict[str, list[tuple[Phrase, Any]]]:
    """Return a dictionary from each word to the rows whose phrase may begin with it."""
    found: dict[str, list[tuple[Phrase, Any]]] = {}
    for row in rows:
        for part in row[0]:
            if isinstance(part, str):
                found.setdefault(part, []).append(row)
                break
            for word in part.phrases:
                found.setdefault(word, []).append(row)
            if not part.may_be_empty:
                break
    return found


def _ends(phrase: Phrase, reading: Reading, at: int) -> set[int]:
    """End of a phrase that begins at a word and has one word at least."""
    ends = {at}
    for part in phrase:
        if isinstance(part, str):
            ends = {end + 1 for end in ends if reading.words[end] == part}
        else:
            further = {
                last
                for end in ends
                for inner, _ in part.phrases.get(reading.words[end], ())
                for last in _ends(inner, reading, end)
            }
            ends = ends | further if part.may_be_empty else further
        if not ends:
            break
    return ends - {at} if at in ends else ends


def constant(value: Any) -> Rule:
    """Return the rule that matches no words and has a value."""
    return Rule(lambda reading, at: {at: (value,)}, frozenset, True)


NOTHING = Rule(lambda reading, at: {at: ()}, frozenset, True)
"""No word at all."""


def silent(rule: Rule) -> Rule:
    """Return the rule without its values."""
    return Rule(lambda reading, at: dict.fromkeys(rule.at(reading, at), ()), lambda: rule.first, rule.may_be_empty)


def either(*rules: Rule) -> Rule:
    """Return the rule of any of the rules, earlier ones preferred."""

    def match(reading: Reading, at: int) -> Ways:
        ways: Ways = {}
        for rule in rules:
            for end, values in rule.at(reading, at).items():
                if end not in ways:
                    ways[end] = values
        return ways

    return Rule(match, lambda: _any_of(rules), any(rule.may_be_empty for rule in rules))


def _any_of(rules: Sequence[Rule]) -> frozenset[str] | None:
    """Return the first words of several rules; None where those of one are not known."""
    begins = [rule.first for rule in rules if rule.first is not None]
    return frozenset().union(*begins) if len(begins) == len(rules) else None


def here(condition: Callable[[Reading, int], Any]) -> Rule:
    """Return the rule that matches no words where a condition holds."""
    return Rule(lambda reading, at: {at: ()} if condition(reading, at) else {}, frozenset, True)


def unless(rule: Rule) -> Rule:
    """Return the rule that matches no words where another rule does not match."""
    return here(lambda reading, at: not rule.at(reading, at))


def optional(rule: Rule, default: Any = None) -> Rule:
    """Return the rule that has the value of another, or the default where that does not match."""
    return either(rule, constant(default))


def listed(item: Rule, separator: Rule) -> Rule:
    """Return the rule of items with separators between, fewest items first.

    Its value is a tuple of (values of the separator, then of the item) for each item.
    """

    def match(reading: Reading, at: int) -> Ways:
        ways: dict[int, tuple[Any, ...]] = {}
        front: Ways = {end: (values,) for end, values in item.at(reading, at).items()}
        while front:
            ways |= {end: found for end, found in front.items() if end not in ways}
            following: Ways = {}
            for end, found in front.items():
                for middle, between in separator.at(reading, end).items():
                    for last, values in item.at(reading, middle).items():
                        if last not in ways and last > end:
                            following.setdefault(last, (*found, between + values))
            front = following
        return {end: (ways[end],) for end in ways}

    return Rule(match, lambda: item.first, item.may_be_empty)


Matches = dict[int, list[tuple[int, Any]]]
"""Word where a slot matches -> its (end, value)."""
Gaps = list[dict[int, int]]
"""Per word: where words that no slot explains end -> what leaving them unexplained costs."""


def matches_of(slots: Mapping[str, Rule], needed: frozenset[str], reading: Reading) -> dict[str, Matches]:
    """Return the matches of each slot that has any in a sentence; empty where a slot in `needed` has none."""
    if not all(_places_of(slots[name], reading) for name in needed):
        return {}
    return {name: found for name, rule in slots.items() if (found := _places_of(rule, reading))}


def _places_of(rule: Rule, reading: Reading) -> Matches:
    """Return the matches of a rule in a sentence, remembered since many slots share a rule."""
    found = reading.places.get(rule.number)
    if found is None:
        found = reading.places[rule.number] = {}
        for at in range(len(reading.tokens)):
            ways = [(end, values[0] if values else None) for end, values in rule.at(reading, at).items() if end > at]
            if ways:
                found[at] = ways
    return found


_MORE_SLOTS, _LATER_WAY = 0.01, 0.001
"""Of covers that leave the same words unexplained the one with more slots is preferred, then the one whose slots match as they
prefer to."""


class Cover(NamedTuple):
    """Slots that cover words of a sentence, with words between that none explains."""

    cost: float
    values: dict[str, Any]
    idle: tuple[int, ...] = ()
    """The words left unexplained at more than the least cost."""


def covers(
    matches: Mapping[str, Matches], needed: frozenset[str], gaps: Gaps, start: int = 0
) -> dict[int, list[Cover]]:
    """Return the covers from word `start` to each later one, cheapest first.

    Each fills a slot at most once, and those in `needed` always.
    """
    bits = {name: 1 << number for number, name in enumerate(matches)}
    if not needed <= bits.keys():
        return {}
    wanted = sum(bits[name] for name in needed)
    ways: list[dict[int, Cover]] = [{} for _ in range(len(gaps) + 1)]
    ways[start][0] = Cover(0, {})
    for at in range(start, len(gaps)):
        for filled, (cost, values, idle) in ways[at].items():
            for name, bit in bits.items():
                for rank, (end, value) in enumerate(() if filled & bit else matches[name].get(at, ())):
                    before, price = ways[end].get(filled | bit), cost + _LATER_WAY * rank - _MORE_SLOTS
                    if end > at and (before is None or price < before.cost):
                        ways[end][filled | bit] = Cover(price, {**values, name: value}, idle)
            for end, loss in gaps[at].items():
                before = ways[end].get(filled)
                if end > at and (before is None or cost + loss < before.cost):
                    left = (*idle, *range(at, end)) if loss > end - at else idle
                    ways[end][filled] = Cover(cost + loss, values, left)
    best: dict[int, list[Cover]] = {}
    for end, found in enumerate(ways[start + 1 :], start + 1):
        if whole := [cover for filled, cover in found.items() if not wanted & ~filled and filled]:
            best[end] = sorted(whole, key=itemgetter(0))
    return best


def later(rule: Callable[[], Rule]) -> Rule:
    """Return the rule that a function returns when it is needed: two rules may hold each other."""
    return Rule(lambda reading, at: rule().at(reading, at))


def generated(
    match: Callable[[Reading, int], Iterator[tuple[int, Any]]],
    first_words: Callable[[], frozenset[str] | None] = lambda: None,
) -> Rule:
    """Return the rule of a generator of (end, value), best first; `first_words` is that of a rule."""

    def all_ways(reading: Reading, at: int) -> Ways:
        ways: Ways = {}
        for end, found in match(reading, at):
            ways.setdefault(end, (found,))
        return ways

    return Rule(all_ways, first_words)
