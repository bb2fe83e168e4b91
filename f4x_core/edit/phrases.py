"""Phrases of edits: who, when, how much, which way. A `SentenceContext` resolves what depends on the clip, once all is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec

from ..language.amounts import VIEWER, direction, number, number_at
from ..language.cast_words import is_cast
from ..language.colour_names import COLOURS, SHADES
from ..language.colours import PURE_COLOURS, colour
from ..language.compounds import is_adjective
from ..language.grammar import (
    NOTHING,
    VOCABULARY,
    Reading,
    Rule,
    either,
    generated,
    here,
    keyword,
    later,
    listed,
    literal,
    optional,
    sign,
    silent,
    table,
    unless,
)
from ..language.lexicon import (
    EVERYBODY,
    FUNCTION_WORDS,
    NO_THINGS,
    ONES,
    PEOPLE,
    PICTURE,
    SETTING,
    TENS,
    WHICH,
    is_adverb,
    singular,
    word_set,
)
from ..language.notation import Notation
from ..language.refusal import Final, Mismatch, Refusal
from ..language.times import END, START, Clip, Span, no_such_time
from ..language.verbs import IMPERATIVES, any_form
from .selects import (
    COPY,
    SHARES,
    All,
    And,
    Beside,
    Current,
    Heading,
    Instance,
    Moving,
    Named,
    Not,
    Or,
    Part,
    Point,
    SelectKind,
    Text,
    Where,
)

if TYPE_CHECKING:
    from .change import Change

HIM_OR_HER = {"'him'": ("man", "boy", "person", "people"), "'her'": ("woman", "girl", "person", "people")}
"""Pronoun -> the label that it means where nothing was named: the first of these that the scene knows."""
EDGE = 1 / 3
"""Fraction of a clip that "at the end" means at most."""


@dataclass
class SentenceContext(Clip):
    """The clip and names that a sentence refers to, and what the sentence has named so far."""

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
    labels: frozenset[str] = frozenset()
    """Words that the scene knows."""
    overall: bool = False
    """"Overall" is said: "it" is the picture where nothing was named."""
    spared: list[SelectKind] = field(default_factory=list)
    """Selections that are to stay as they are."""
    sparing: Who | None = None
    """Whom the command that is read leaves as they are."""
    complaints: list[Change] = field(default_factory=list)
    """Operations that would help against the complaint of the sentence."""
    earlier: Mapping[SelectKind, SelectKind] = field(default_factory=dict)
    """The copies of each earlier command that made some, the last one last -> what was copied."""

    @property
    def present(self) -> int:
        """The clip frame through which "the left one" is seen."""
        return min(max(round(self.frame), 0), self.frames - 1)

    @property
    def edge(self) -> float:
        """Frames of "at the beginning" and "at the end": a second, or a third of a shorter clip."""
        return float(min(self.fps, EDGE * self.frames, self.frames - 1))

    def it(self, word: str) -> SelectKind:
        """Return the thing named last, else the selection, else the one man or woman whom `word` can mean; Refusal without any."""
        if self.last is None and not self.selected and word in HIM_OR_HER:
            meant = next((label for label in HIM_OR_HER[word] if label in self.labels), None)
            self.last = None if meant is None else Text((meant,), single=(meant,))
        if self.last is None and not self.selected and self.overall and word in ("'it'", "'its'"):
            return All()
        if self.last is None and not self.selected:
            raise Final(f"Nothing is named or selected that {word} could be; name a thing or select one.")
        return self.last or Current()

    def rest(self) -> SelectKind:
        """Return everything but the last thing named, or else what the command leaves as it is."""
        if self.last is None and self.sparing is not None:
            spared, self.last = self.sparing(self), None
            return Not(spared)
        return Not(self.it("'else'"))

    def one(self) -> SelectKind:
        """Return the kind that "the left one" picks from: that of the last thing named, after copying with its copies."""
        select = self.it("'one'")
        if isinstance(select, Named) and select.name in self.copies:
            return together((self.copies[select.name], select))
        return select.of if isinstance(select, Instance) else select

    @property
    def next_copy(self) -> str:
        """The name of the next copies that nobody names."""
        return f"{COPY} {len(self.copies) + 1}" if self.copies else COPY

    def copied(self, operation: Any) -> tuple[Any, SelectKind]:
        """Return (the operation with a name for its copies, which "it" means from now on; the selection that "they" means)."""
        name = operation.name
        if not name:
            name = self.next_copy
            self.spare.add(name)
        self.copies[name] = operation.select
        self.last = Named(name)
        return replace(operation, name=name), self.one() if operation.count == 1 else self.last

    def and_copies(self, select: SelectKind) -> SelectKind:
        """Return the selection of a plural noun: the object and the copies that the sentence made of it."""
        return together((select, *(Named(name) for name, who in self.copies.items() if who == select)))


@dataclass(frozen=True)
class When:
    """A span settled against the clip, in the words of each operation."""

    frames: tuple[float, float | None] | None = None
    """None: no time is given."""
    kind: str = "range"
    """As in `Span`."""
    slowly: bool = False
    """It is said to come little by little."""
    soft: bool = False
    """Little by little at both ends: it comes and is over at the last."""
    edge: tuple[float, float | None] | None = None
    """The frames that "at the beginning" or "at the end" means for what is in effect for a while."""

    @classmethod
    def of(cls, phrase: Span | None, context: SentenceContext, slowly: bool = False, soft: bool = False) -> When:
        """Clip frames of a span; Refusal: outside of the clip, or ending before it starts."""
        if phrase is None or phrase.kind == "always":
            return cls(kind=phrase.kind if phrase else "range", slowly=slowly, soft=soft)
        start, end = phrase.start.resolve(context), None if phrase.end is None else phrase.end.resolve(context)
        last = context.frames - 1
        # The instant in which the last frame ends is still the clip: "to second 6" of six seconds.
        for time, frame, latest in ((phrase.start, start, last), (phrase.end, end, last + 1)):
            if time is not None and frame is not None and not 0 <= frame <= latest:
                raise Refusal(no_such_time(time, context))
        end = None if end is None or (phrase.end == END and phrase.kind != "by") else min(end, last)
        if end is not None and end < start:
            raise Refusal(f"The time from frame {start:g} to frame {end:g} ends before it starts.")
        kind = "moment" if phrase.kind == "from" else phrase.kind
        slowly = slowly or (kind == "by" and phrase.end == END)
        edge = None
        if phrase.kind == "moment" and phrase.start in (START, END):
            edge = (0.0, context.edge) if phrase.start == START else (last - context.edge, None)
        return cls((float(start), None if end is None else float(end)), kind, slowly, soft, edge)

    @property
    def effect(self) -> dict[str, Any]:
        """Field `frames` of what is in effect for a while."""
        if self.slowly:
            raise Refusal("That cannot come little by little: it is there or not; leave 'slowly' out.")
        if self.kind == "by" and self.frames is not None:  # blue by second 2: from then on for sure
            return {"frames": (self.frames[1], None)}
        return self._frames if self.edge is None else {"frames": self.edge}

    @property
    def coming(self) -> dict[str, Any]:
        """Fields of a change of colours, which may come little by little."""
        return {"frames": (0.0, None), **self._frames, "ease": "linear"} if self.slowly else self.effect

    @property
    def _frames(self) -> dict[str, Any]:
        if self.kind == "length":
            raise Refusal("It is said how long, not from when; add for example 'from second 1'.")
        if self.kind == "in" and self.frames is not None:
            return {"frames": (self.frames[1], None)}
        return {} if self.frames is None else {"frames": self.frames}

    @property
    def growth(self) -> dict[str, Any]:
        """Fields of a transform: grows over a range, or for so long from the present frame on, jumps at a moment."""
        if self.kind in ("length", "in") and self.frames is not None:
            return {"frames": self.frames}
        if self.slowly and self.frames is None:
            return {"frames": (0.0, None)}
        if self.edge is not None and self.edge[0] > 0:  # "at the end": so that it can be seen
            return {"frames": self.edge}
        if self.kind == "moment" and self.frames is not None and not self.slowly:
            return {"frames": (self.frames[0], self.frames[0]), "ease": "step"}
        return self._frames

    @property
    def pace(self) -> dict[str, Any]:
        """Fields of a change of speed."""
        return (self._frames if self.edge is None else {"frames": self.edge}) | (
            {"ease": "soft" if self.soft else "smooth"} if self.slowly else {}
        )

    def fading(self, context: SentenceContext, inward: bool) -> dict[str, Any]:
        """Return the fields of a gradual opacity: over a range, over a second "at the end" or, with `inward`, "at the start"."""
        frames, last = self.frames, context.frames - 1
        if (
            self.kind in ("length", "in") and frames is not None and frames[1] is not None
        ):  # the first seconds, or the last ones
            length = frames[1] - frames[0]
            return {"frames": (0.0, length) if inward else (max(last - length, 0.0), None), "ease": "linear"}
        if self.kind == "moment" and frames is not None and frames[0] == (0 if inward else last):
            frames = (0.0, context.edge) if inward else (last - context.edge, None)
        elif frames is None or (self.kind not in ("range", "by") and not self.slowly):
            return self._frames
        return self._frames | {"frames": frames, "ease": "linear"}

    def pause(self, context: SentenceContext) -> dict[str, Any]:
        """Return the fields of a freeze."""
        if self.frames is None:
            return {"at": float(context.frame)}
        first, last = self.frames
        return {"at": first} | ({} if last is None or last - first <= 1 else {"until": last})  # "on the first frame"

    def none(self, what: str) -> dict[str, Any]:
        """Return no field; raises Refusal where the sentence names a time."""
        if self.frames is not None:
            raise Refusal(f"{what} is for the whole clip; leave the time out.")
        return {}


# Who -----------------------------------------------------------------------------------------------------------------

Who = Callable[[SentenceContext], SelectKind]
"""Rule of an object phrase; it notes itself as the last thing named."""
Values = ParamSpec("Values")


def who_of(make: Callable[Concatenate[SentenceContext, Values], SelectKind]) -> Callable[Values, Who]:
    """Return the function of the values of a phrase that makes a `Who`; `make` gets the context before them."""

    def made(*args: Values.args, **kwargs: Values.kwargs) -> Who:
        return lambda context: make(context, *args, **kwargs)

    return made


_DESCRIBING = word_set("big large small tiny bright dark light fast slow quick static standing still whole little")
"""Words of the grammar that may also stand before a noun."""

_NO_SUPERLATIVES = word_set("forest nest chest vest guest west crest priest harvest pest rest quest test breast")
"""Words in -est that are things: "the fastest car" is one of several, and nobody can tell which."""


_NOUNS = word_set(
    "dress sail path curb stone splash sky floor ground coat mask head hair hand wheel cover slide park plant stick brush "
    "pan brake kite tail wrap bin axe float duck beam veil cloak balloon trash pump cap"
)
"""Words of the grammar that are things behind an article."""


def _is_noun(reading: Reading, at: int) -> bool:
    return (
        singular(reading.word(at)) in _NOUNS
        and at > 0
        and (reading.word(at - 1) in ("the", "a", "an", "my", "her", "his", "their", "its", "that", "this", "'s"))
    )


def _open(reading: Reading, at: int) -> bool:
    """Return True if the word could be (part of) the name of a thing that nobody knows yet."""
    word = reading.word(at)
    return (
        at < len(reading.tokens)
        and reading.tokens[at].is_word
        and word not in FUNCTION_WORDS
        and word not in NO_THINGS
        and (word not in VOCABULARY or word in _DESCRIBING or word in COLOURS or _is_noun(reading, at))
        and not is_adverb(word)
        and (not word.endswith("est") or word in _NO_SUPERLATIVES)
    )


def _known_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, label or name) of those that begin at a word, longest first."""
    words = tuple(reading.word(i) for i in range(at, min(at + reading.longest, len(reading.tokens))))
    for count in range(len(words), 0, -1):
        for form in (words[:count], (*words[: count - 1], singular(words[count - 1]))):
            if form in reading.known:
                yield at + count, reading.known[form]
                break


_MAX_MODIFIERS = 3


def _modified_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, text) of a known thing behind other words: "parked car", "woman's hat"."""
    before = at
    behind_article = reading.word(at - 1) in _ARTICLES
    while before - at < _MAX_MODIFIERS and (
        _open(reading, before)
        or reading.word(before) in SHADES
        or (reading.word(before),) in reading.known
        or (behind_article and (_describes(reading.word(before)) or (before == at and _is_done_with(reading, at))))
    ):
        thing_before = before > at and reading.word(before - 1) not in SHADES
        if reading.word(before) in COLOURS and thing_before and any(True for _ in _known_at(reading, before - 1)):
            return  # "dog blue cat" are two
        before += 1
        if reading.word(before) == "'s":
            before += 1
        seen = {reading.word(i) for i in range(at, before)}
        for end, label in _known_at(reading, before):
            if reading.word(end - 1) not in seen:
                yield end, f"{reading.text_of(at, before).lower()} {label}"


_ARTICLES = word_set("the a an my our that this your his her their these those")
_SELECTING = word_set(
    "moving static missing remaining missed only many any every early ordinary duplicated copied selected"
)
"""Words that say which of several and are nothing that a thing is like."""
_COPYING = frozenset(any_form("copy").split("|"))
"""Verbs that before a thing mean its copy."""


def _describes(word: str) -> bool:
    """Return True if a word before a noun says what it is like, also where it means something elsewhere: "the shiny car"."""
    return is_adjective(word) and word not in FUNCTION_WORDS | NO_THINGS | _SELECTING | ONES.keys() | TENS.keys()


def _is_done_with(reading: Reading, at: int) -> bool:
    """Return True if a verb before a known thing says what it is for: "drift car"."""
    word = reading.word(at)
    return word in IMPERATIVES - FUNCTION_WORDS - _SELECTING - _COPYING and any(_known_at(reading, at + 1))


_PARTS_IN_ING = word_set("wing ring earring lining railing clothing building painting string spring ceiling coating")


def _part_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, text) of a known part of a known whole: "roof of the house"."""
    for middle, part in _known_at(reading, at):
        if reading.word(middle) == "'s":  # a part that no label has is the scene's to know
            for end, stranger in _stranger_at(reading, middle + 1):
                if not stranger.endswith("ing") or stranger in _PARTS_IN_ING:  # "the dog's barking" is none
                    yield end, f"{reading.text_of(at, middle).lower()}'s {stranger}"
        if reading.word(middle) == "of":
            whole = middle + 1 + (reading.word(middle + 1) in ("the", "a", "an", "that", "this", "my"))
            strangers = _stranger_at(reading, whole) if whole > middle + 1 else ()
            for end, label in (*_known_at(reading, whole), *strangers):
                yield end, f"{part} {reading.text_of(middle, whole).lower()} {label}"


_CAST = word_set("shadow shadows reflection reflections")
"""Nouns of cast things, which may stand without an article: "shadow of dog"."""


_OF_WHOLE = word_set("the a an that this my all every any")


def _part_of_known_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, text) of a part without a label, of a known whole: "legs of the dog"."""
    for middle, part in (*_stranger_at(reading, at), *_strangers_at(reading, at), *_modified_at(reading, at)):
        whole = middle + 1 + (reading.word(middle + 1) in _OF_WHOLE)
        if reading.word(middle) == "of" and (whole > middle + 1 or part in _CAST):
            for end, label in _known_at(reading, whole + (reading.word(whole) in ("the", "these", "those"))):
                yield end, f"{label}'s {part}"


def _wearing_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, text) of a known thing with its clothes or things: "woman in red", "man with the yellow hat"."""
    for middle, label in (*_known_at(reading, at), *_modified_at(reading, at)):
        if reading.word(middle) not in ("in", "with", "wearing"):
            continue
        start = middle + 1 + (reading.word(middle + 1) in ("the", "a", "an", "his", "her", "their", "its"))
        worn = [
            end for end, _ in (*_known_at(reading, start), *_modified_at(reading, start), *_stranger_at(reading, start))
        ]
        worn += [end + 1 for end in colour.at(reading, start) for _ in _stranger_at(reading, end)]
        worn += list(colour.at(reading, start)) if start == middle + 1 and reading.word(middle) == "in" else []
        for end in dict.fromkeys(worn):
            hue = reading.word(middle) == "in" and end in colour.at(reading, start)
            if (hue and re.match(PEOPLE, label.split()[-1])) or singular(reading.word(end - 1)) in _WORN:
                yield end, f"{label} {reading.text_of(middle, end).lower()}"


_WORN = word_set(
    "hat cap helmet shirt jacket coat dress sweater jersey pullover hoodie scarf trousers jeans shorts pants skirt suit "
    "uniform vest boot shoe glasses sunglasses glove bag backpack rucksack umbrella hair beard mustache tail horn collar "
    "top t tie mask belt sock"
)
"""Words that tell things of a kind apart. "The dog with the cat" may be one thing or two."""


def _stranger_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, word) of one word that no label has."""
    word = reading.word(at)
    if (
        _open(reading, at)
        and singular(word) not in PURE_COLOURS
        and word not in _DESCRIBING
        and (singular(word) not in IMPERATIVES or _is_noun(reading, at))
        and singular(word) not in NO_THINGS
    ):
        text = reading.text_of(at, at + 1).lower()
        yield at + 1, singular(text)


_CHANGING = frozenset(
    any_form("delete", "hide", "blur", "brighten", "darken", "desaturate", "freeze", "isolate").split("|")
)
"""Verbs of which a note begins: they are for what is there, which "add sunglasses" is not."""
_SUBJECTS = word_set("it he she this that which who i you we they")
"""Words behind which a verb stands: "it frightens me"."""


def _bare_stranger_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, word) of one unknown word without an article, which might be a verb ("and juggle").

    That is a thing where no label is known at all, in the plural, where the sentence named it before, a shadow, or behind the verb
    that a note begins with: "omit vehicle".
    """
    earlier_words = {token.text for token in reading.tokens[:at]}
    noted = at == 1 and reading.word(0) in _CHANGING
    for end, name in _stranger_at(reading, at) if reading.word(at - 1) not in _SUBJECTS else ():
        if noted or not reading.known or _is_plural(reading, at) or name in earlier_words or is_cast(name):
            yield end, name


def _strangers_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, text) of two or three words without a label, behind an article: "flux capacitor"."""
    end = at
    while end - at < _MAX_MODIFIERS and _open(reading, end) and not any(True for _ in _known_at(reading, end)):
        end += 1
    if reading.word(end) in _ARTICLES and reading.word(end - 1).endswith("s"):  # "the client hates the color"
        return
    for last in range(at + 2, end + 1):
        for _, name in _stranger_at(reading, last - 1):
            yield last, f"{reading.text_of(at, last - 1).lower()} {name}"


def _everybody_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, label) of "everyone"."""
    if reading.word(at) in ("everyone", "everybody", "whoever"):
        yield at + 1, next((label for label in EVERYBODY if (label,) in reading.known), EVERYBODY[0])


_count = generated(
    lambda reading, at: ((end, int(x)) for end, x in number_at(reading, at) if x >= 2), lambda: number.first
)
_several = silent(_count)
_article = keyword(
    "the|a|an|this|that|these|those|my|our|your|its|his|her|their|every|each|any|all|all (of) [the|these|those|my]|both|"
    "both (of) the|each of the|every one of the|every single|the [whole|entire]"
)
_determiner = _article + ~_several


def _things(match: Callable[[Reading, int], Iterator[tuple[int, str]]]) -> Rule:
    """Return the rule that makes a `Who` of a noun."""

    def thing_at(reading: Reading, at: int) -> Iterator[tuple[int, Who]]:
        every = _is_every(reading, at)
        for end, label in match(reading, at):
            plural = _is_plural(reading, end - 1)
            yield end, _thing(label, plural, single=not (every or plural))

    return generated(thing_at)


_EVERY = word_set("every each any all both no everyone everybody whoever")
"""Words that with a noun in the singular mean all of its kind."""


def _is_every(reading: Reading, at: int) -> bool:
    """Return True where the words before a noun, or the noun itself, mean all of its kind: "each of the"."""
    before = at - 1
    while reading.word(before) in ("single", "one", "of", "the", "my", "these", "those"):
        before -= 1
    return (
        not _EVERY.isdisjoint((reading.word(before), reading.word(at))) if before >= 0 else reading.word(at) in _EVERY
    )


@who_of
def _thing(context: SentenceContext, label: str, plural: bool, single: bool = False) -> SelectKind:
    if label == COPY and (context.copies or context.earlier):
        return _the_copy()(context)
    name = context.names.get(label.lower())
    alone = context.earlier and not plural  # what was copied in an earlier sentence
    one = (label,) if single else ()
    select = Text((label,), number="one" if alone else "any", single=one) if name is None else Named(name)
    return context.and_copies(select) if plural else select


def _always(select: SelectKind) -> Callable[..., Who]:
    return lambda *_: lambda context: select


_OBJECTS = "thing|things|object|objects|item|items|part|parts|stuff|one|ones|content|contents|element|elements"
_objects = keyword(_OBJECTS)
_known, _part, _modified, _stranger = map(_things, (_known_at, _part_at, _modified_at, _stranger_at))
_everybody, _strangers, _bare_stranger = map(_things, (_everybody_at, _strangers_at, _bare_stranger_at))


@who_of
def _so_many(context: SentenceContext, count: int, noun: Who) -> SelectKind:
    select = noun(context)
    return replace(select, count=count) if isinstance(select, Text) else select


_part_of_known = (_article | here(lambda reading, at: reading.word(at) in _CAST)) + _things(_part_of_known_at)
familiar = either(_part, _known, _modified, _everybody)
"""A noun that the scene knows."""
_noun = either(_part, _known, _modified, _stranger)
_determined = either(
    _determiner + _noun,
    _count + (here(lambda reading, at: not reading.known) + _noun | _part | _known | _modified) >> _so_many,
)
"""A noun with its article or number; what nobody knows with a number alone might be copies, echoes, times."""
_named_at_length = _article + _strangers
WHERE: dict[str, Where] = {
    "(right) next to|(right) beside|alongside|(right) by|(very) close to|near|nearest (to)|closest (to)|nearer (to)|closer "
    "(to)|adjacent to|over by|right at|against": "near",
    "(to the) left of|[on|at|to] the left (side|hand side) of|left from|left next to": "left",
    "(to the) right of|[on|at|to] the right (side|hand side) of|right from": "right",
    "behind|in back of|at the back of|further back than": "behind",
    "in front of|before|ahead of": "front",
    "above|over|on top of|on|(up) onto|up on": "above",
    "below|under|underneath|beneath": "below",
}
"""Words -> how a thing stands to another."""
_stands = ~keyword(
    "(that|which|who) (is|are|was|were|stands|stand|sits|sit|lies|lie|comes|come|goes|go|walks|walk|runs|run|standing|"
    "sitting|lying|walking|running|hangs|hanging|rides|drives|located|placed|that comes|is standing|is sitting|is lying|"
    "are standing|comes right|right|directly)"
)
_neighbour = later(lambda: _one_thing)
"""To whom something stands; by name, because it may itself be told by where it stands."""


@who_of
def _beside(context: SentenceContext, kind: tuple[Who, bool], where: Where, other: Who) -> SelectKind:
    of, plural = kind[0](context), kind[1]
    context.last = Beside(of, where, other(context), plural, context.present)
    return context.last


def _plural_at(reading: Reading, at: int) -> Iterator[tuple[int, Who]]:
    """Yield (end, who) of a noun in the plural."""
    yield from ((end, who) for end, (who,) in _noun.at(reading, at).items() if _is_plural(reading, end - 1))


_wearing = ~_article + _things(_wearing_at)
_say = Notation(globals(), VOCABULARY)
_all_that = keyword(
    "what|whatever|[everything|anything|all] [that|which]|(the|all) (the) [things|objects|ones|stuff|parts] [that|which]"
)
_all_that_go = keyword("everything|everyone|anything|all|what|whatever")
_moving = _say(
    "<_all_that> [moves|move|is moving|are moving|is in motion|does move]|(<_article>) moving <_objects>|[the|"
    "all the] (whole|entire) foreground|the [one|ones|thing|things|object] [that|which] (is|are) [runs|run|"
    "walks|walk|running|walking|moving|moves|move]|(<_article>) [subject|subjects|talent]"
) >> _always(Moving())
_static = _say(
    "<_all_that> [stands still|stand still|stays still|stay still|is still|are still|is static|are static|"
    "does not move|do not move|is not moving|are not moving|rests|is at rest|never moves]|(<_article>) "
    "[static|still|standing|stationary|motionless|unmoving|fixed] [<_objects>|background|scene]|(([everything|"
    "all|anything|what is|whatever is|all that is|everything that is] (back) in) (the|its|all the)) (whole|"
    "entire) [background|backdrop|surroundings|scenery]"
) >> _always(Not(Moving()))


def _heading_of(way: tuple[int, int, int]) -> Heading:
    """Return what goes sideways; Mismatch for other ways."""
    if not way[0]:
        raise Mismatch
    return Heading("left" if way[0] < 0 else "right")


_going = (
    keyword(
        "[that|which|who] (is|are) [goes|go|moves|move|walks|walk|runs|run|drives|drive|flies|fly|going|moving|walking|running|"
        "driving|flying|heading]|going|moving|walking|running|driving|flying|heading|traveling"
    )
    + direction
    >> _heading_of
)
_heading_thing = (_all_that_go | ~_article + _objects) + _going >> (lambda way: lambda context: way)
_heading = (~_article + _noun | _everybody) + _going >> (lambda noun, way: lambda context: And((noun(context), way)))
_moving_noun = _say(
    "(<_article>) moving <_noun>|[(<_article>) <_noun>|<_everybody>] [that|which|who] [is moving|are moving|"
    "moves|move|is in motion|are in motion]"
) >> (lambda noun: lambda context: And((noun(context), Moving())))
_WHERE = {
    f"[on|at|to|of|in] [the|its] (far) left (side|hand side|edge) (of [the|this] [{PICTURE}])|to the far left": "left",
    f"[on|at|to|of|in] [the|its] (far) right (side|hand side|edge) (of [the|this] [{PICTURE}])": "right",
    "in the left (hand) [half|part|third|corner]|(on) [camera|screen|frame|stage] left": "left",
    "in the right (hand) [half|part|third|corner]|(on) [camera|screen|frame|stage] right": "right",
    "in the [upper|top] [half|part|third|corner]": "top",
    "in the [lower|bottom] [half|part|third|corner]": "bottom",
    **{
        f"[in|at|on|of] (the) [{names}] {side} (hand) (corner)": f"{row} {side}"
        for names, row in (("upper|top", "top"), ("lower|bottom", "bottom"))
        for side in ("left", "right")
    },
    "[farthest|furthest|closest|nearest|most] (to|on|at) (the) left": "left",
    "[farthest|furthest|closest|nearest|most] (to|on|at) (the) right": "right",
    "at the (very) top|on (the) top|on the top side": "top",
    "at the (very) bottom|on the bottom": "bottom",
    "in the (very) [middle|center]|at the center": "middle",
    f"in front|in the [front|foreground]|up front|nearer to [{VIEWER}]|at the front|[closest|nearest]"
    f" to [{VIEWER}]|closest|nearest": "nearest",
    "(that is|which is|that are) [farther|further] (away|off|back)": "farthest",
    "(that is|which is|that are) [nearer|closer] (to us|by)": "nearest",
    "in the [back|background|distance|rear]|at the [back|rear]|[of|from] (the) [behind|back]|(way|right) back there|far away|"
    f"[farthest|furthest] (away) from [{VIEWER}]|farthest (away)|furthest (away)": "farthest",
}
_which, _where = (
    table(WHICH),
    ~keyword("(that|which|who) [is|are|stands|sits] (standing|sitting)|standing|sitting") + table(_WHERE),
)
_seen_in = optional(keyword("[of|as of|seen in|seen at] frame") + number)
_kind = either(
    _moving,
    _moving_noun,
    _say("<_noun>|[one|ones] of (the|these|those|my|all the) <_noun>"),
    keyword("of (the|these|those|my|all the)") + ~_several + generated(_plural_at),
    keyword("one|ones") >> (lambda: SentenceContext.one),
    keyword("thing|object|item|element") >> _always(All()),
)


@who_of
def _one_of(context: SentenceContext, which: Any, kind: Who, seen: float | None) -> SelectKind:
    frame = context.present if seen is None else _frame(seen, context)
    of = kind(context)
    of = replace(of, number="any") if isinstance(of, Text) else of  # of a thing and its copies one is the left one
    return Instance(context.and_copies(of), which, frame)


def _frame(number: float, context: SentenceContext) -> int:
    if number != int(number) or not 0 <= number < context.frames:
        raise Refusal(f"Frame {number:g} is none of the clip's, 0 to {context.frames - 1}.")
    return int(number)


_of_size = keyword("the") + table(
    {"big|large|huge|tall|giant": "largest", "small|little|tiny|wee": "smallest"}, reserve=False
)
_sized_one = _of_size + _known + here(lambda reading, at: not _is_plural(reading, at - 1)) + _seen_in >> _one_of
_instance: Rule = either(
    _sized_one,
    ~_article + _which + _kind + ~keyword(f"[to|from] [{VIEWER}]") + _seen_in >> _one_of,
    ~_article + _kind + _where + _seen_in >> (lambda kind, which, seen: _one_of(which, kind, seen)),
)
several_placed = generated(_plural_at) + _where
"""Several of a kind that are told by a place, by which only one is found: "the people in the background"."""
_place = (
    ~sign("(") + ~keyword("(pixel|position|point|x) (=|:)") + number + ~keyword("(,|y|and) (=|:)") + number + ~sign(")")
)
_seen_then = keyword("[in|at|of|on] frame") + number
_point = keyword(
    "[(the|that|this) [thing|object|item|spot|point|part]|(the) pixel|what is|whatever is|what you see|the one] [at|on|under]"
) + _place + optional(_seen_then) + unless(_seen_then) >> (
    lambda x, y, seen: lambda context: Point(context.present if seen is None else _frame(seen, context), x, y)
)
_SIDE_OF = {"upper|top": "top", "lower|bottom": "bottom", "left|left hand": "left", "right|right hand": "right"}
_whole = later(lambda: _whole_thing)
"""A thing that has parts; by name, because things are made of parts of things."""
_part_of = ~keyword("the|its") + table(_SIDE_OF, reserve=False) + table(SHARES, reserve=False)


@who_of
def _placed_part(context: SentenceContext, side: Any, share: float, whole: Who) -> SelectKind:
    return Part(whole(context), side, share, context.present)


_pronoun = who_of(SentenceContext.it)
_side, _share = table(_SIDE_OF, reserve=False), table(SHARES, reserve=False)
_end_of = table({"top": "top", "bottom": "bottom"})
_placed = either(
    _part_of + keyword("of") + _whole >> _placed_part,
    _say("[<familiar>|(<_article>) <_noun>] ['s|'] <_part_of>")
    >> (lambda whole, side, share: _placed_part(side, share, whole)),
    _say("(the|its) <_end_of> of <_whole>") >> (lambda side, whole: _placed_part(side, 0.5, whole)),
    _say("[its|his|her|their|the] <_side> <_share>")
    >> (lambda side, share: _placed_part(side, share, _pronoun("'its'"))),
)
_it_words = "it|this|that|itself|[this|that|the] [thing|one|object]|all of [it|this|that]|it all"
_it = table({"him|he": "'him'", "her|she": "'her'", _it_words: "'it'"}) >> _pronoun
_they = keyword(
    "them|these|those|they|themselves|[these|those|the] [things|ones|objects]|all of [them|these|those]|them [all|both]|"
    "both (of them|of these|of those)"
) >> (lambda: lambda context: context.they or context.it("'they'"))


@who_of
def _the_copy(context: SentenceContext) -> SelectKind:
    if context.copies:
        return Named(list(context.copies)[-1])
    if len(context.earlier) > 1:
        raise Refusal("Copies were made more than once; say which is meant, for example 'the left one of' its kind.")
    if not context.earlier:
        raise Refusal("No copy was made before; say which thing is meant.")
    return next(iter(context.earlier))


_COPIES = "[copy|copies|clone|clones|duplicate|duplicates|replica]"
_copy = keyword(f"[the|its|their|his|her] (new) {_COPIES} (of it)|the [new|second|extra|added] one") >> _the_copy
_current = _say(
    "(the|my|our|this) (current) selection|what [i|we|is] (have) selected|everything selected|(the|my|our|"
    "this|these|those|all) (the) (currently) selected <_objects>"
) >> (lambda *_: lambda context: Current() if context.selected else context.it("the selection"))
_all_but = who_of(lambda context, rest: Not(rest(context)))
_everything = keyword(
    "everything|everywhere|all|anything|(everything|all of) the (whole) lot|it all|all of it|all (of) the [things|objects]|all "
    "[things|objects]|every (single) [object|thing]|[everything|all] there is (to see)|"
    f"(the) [whole|entire|full|complete] [{PICTURE}|thing|world]|[the|this] (whole|entire) [world|room|place|set]|"
    f"[the|this|my|our] [{PICTURE}]|all of the [{PICTURE}]|plate"
)
_around = (
    _say("[(the) [world|scene|surroundings|space]|(the|all the) things|everything|all] around <_neighbour>") >> _all_but
)


@who_of
def _the_other(context: SentenceContext, noun: Who | None) -> SelectKind:
    """Return all of the kind but the one that was named last."""
    last = context.it("'the other one'")
    if not isinstance(last, Instance | Beside) or (noun and noun(context) != last.of):
        raise Refusal("Which one is the other is not said; say for example 'the left one'.")
    context.last = And((last.of, Not(last)))
    return context.last


_stays = literal("[can|may|should|must] [stay|remain]|stays|stay|remains|remain")
_other_one = _say("[[the|that] other (one)|the other [ones|two|three]] <familiar?> !<_stays>") >> _the_other
everything_else = keyword(
    f"[everything|all|anything] else|all the rest|the (whole) [rest|remainder] (of [it|them|the world|the [{PICTURE}]])|"
    "all others|(all (of)) the others|all (the) other [things|objects|stuff]|the other [things|objects]"
) >> (lambda *_: SentenceContext.rest)
_in_scene = ~literal(f"in [the|this|our] [{SETTING}]") + ~keyword(
    f"(that is|that are|which is) [in|from|of|within|inside] [the|this|my] (whole|entire) [{PICTURE}]|out of the "
    f"[{PICTURE}]|[over|out|back|up|down] there|over here"
)
_named_noun = _determined | familiar


def _with_number_at(reading: Reading, at: int) -> Iterator[tuple[int, tuple[Who, bool]]]:
    """Yield (end, (who, True in the plural)) of a noun."""
    yield from ((end, (who, _is_plural(reading, end - 1))) for end, (who,) in _named_noun.at(reading, at).items())


_kind_and_number = either(
    keyword(
        "everything|all|whatever|what|anything|all (the) [things|objects]|the [thing|things|object|objects|stuff|item|items]"
    )
    >> (lambda: (lambda context: All(), True)),
    _everybody >> (lambda who: (who, True)),
    ~_article + keyword("one|ones") >> (lambda: (SentenceContext.one, False)),
    generated(_with_number_at),
)
_CIRCLING = frozenset(any_form("rotate", "turn").split("|")) | word_set(
    "move moves moving run runs running walk walks drive drives fly flies go goes ride rides put place add wrap"
)
"""Verbs that go around something themselves: "spin the dog around the tree"."""
_surrounding = here(lambda reading, at: _CIRCLING.isdisjoint(reading.words[:at])) + table(
    {"(all) around|round": "near"}, reserve=False
)
_beside_what = table(WHERE, reserve=False)
_stood = (
    _say("<_kind_and_number> <_stands> [<_beside_what>|<_surrounding>] [<familiar>|<_determined>|<_instance>|<_it>]")
    >> _beside
)
"""A thing named by its place beside another."""
_all = _everything >> _always(All())
_whole_thing: Rule = either(familiar, _determined, _instance, _current, _all, _it, _copy, _static, _moving)
_one_thing: Rule = either(familiar, _determined, _instance, _it, _copy, _part_of_known)
_definite = _say(
    "[<_placed>|<_heading_thing>|<_heading>|<everything_else>|<_current>|<_moving>|<_static>|<_point>|<_sized_one>|<familiar>|<_determined>|<_instance>|"
    "<_moving_noun>|<_part_of_known>|<_named_at_length>|<_wearing>|<_all>|<_it>|<_they>|<_copy>|<_around>|<_other_one>|<_stood>] "
    "<_in_scene>"
)


def together(parts: Sequence[SelectKind]) -> SelectKind:
    """Return the union of the parts; neighbouring labels become one `Text`."""
    merged: list[SelectKind] = []
    for part in parts:
        before = merged[-1] if merged else None
        if isinstance(part, Text) and isinstance(before, Text) and part.number == before.number:
            labels = tuple(dict.fromkeys((*before.labels, *part.labels)))
            merged[-1] = replace(before, labels=labels, single=before.single + part.single)
        elif part != before:
            merged.append(part)
    return merged[0] if len(merged) == 1 else Or(tuple(merged))


@who_of
def _all_of(context: SentenceContext, singles: tuple[tuple[Who], ...]) -> SelectKind:
    parts = []
    for (single,) in singles:
        parts.append(single(context))
        context.last = parts[-1]  # "the table and everything on it"
    context.last = together(parts)
    return context.last


def _is_plural(reading: Reading, at: int) -> bool:
    return singular(reading.word(at)) != reading.word(at)


@who_of
def _both(context: SentenceContext, label: str) -> SelectKind:
    select = _thing(label, plural=True)(context)
    context.last = replace(select, number="both") if isinstance(select, Text) else select
    return context.last


_with_its = literal("with|including") + here(
    lambda reading, at: reading.word(at) in ("its", "his", "her", "their") and reading.word(at + 1) in _CAST
)
_and_also = _with_its | keyword("and|,|, and|and also|plus|+|as well as|along with|together with|and then|and all")


def _is_same_wish(reading: Reading, at: int) -> bool:
    """Return True if no thing follows with a quality of its own as the one before it has: "red cow, blue sky" are two wishes."""
    start = at
    while start > 0 and reading.word(start - 1) in _SEPARATORS:
        start -= 1
    ends_in_a_way = reading.word(start - 1) in _SIDEWAYS
    while start > 0 and reading.word(start - 1) not in _SEPARATORS:
        start -= 1
    if any(reading.word(end) in _ENDS for end in _everything.at(reading, at)):
        return False  # "apart from the dog, everything", "paint out the dog, full shot"
    if ends_in_a_way and any(
        reading.word(way - 1) in _SIDEWAYS and reading.word(way) in _ENDS
        for end in _named_noun.at(reading, at)
        for way in direction.at(reading, end)
    ):
        return False  # "move the dog to the left and the cat to the right"
    ends = (e for i in range(at, at + 4) if reading.word(i) == "in" for e in colour.at(reading, i + 1))
    if reading.word(at - 3) == "in" and colour.at(reading, at - 2) and any(reading.word(e) in _ENDS for e in ends):
        return False  # "the rider in blue, the horse in white"
    named = {reading.word(i) for i in range(start, at)} & {"the", "my", "that", "this"}
    qualified = _quality_at(reading, start) or (named and reading.word(at - 1) == ",")
    return not (qualified and _quality_at(reading, at))


def _quality_at(reading: Reading, at: int) -> bool:
    at += reading.word(at) in ("a", "an")
    return bool(colour.at(reading, at)) or reading.word(at) in ("bigger", "smaller", "larger", "taller", "shorter")


_SEPARATORS = frozenset({",", "and", "or", "plus", "+"})
_SIDEWAYS = word_set("left right up down back forward away closer")
_ENDS = _SEPARATORS | {"", ".", ";", "!", "please"}
_single = either(_definite, _bare_stranger + _in_scene)
two_of_them_behind = ~keyword("(of) (the|these|those|my|our|your)") + generated(
    lambda reading, at: ((end, label) for end, label in _known_at(reading, at) if _is_plural(reading, end - 1))
)
"""A known noun in the plural, behind "both"."""
two_of_them = ~keyword("the two|these two|those two|my two|two|the|my|both") + two_of_them_behind >> _both
"""Two of a kind, who can change places."""
_both_of_them = keyword("both") + two_of_them_behind + _in_scene >> _both
_union = either(_both_of_them, ~keyword("both|either") + listed(_single, _and_also + here(_is_same_wish)) >> _all_of)
known_thing = ~keyword("both") + listed(_definite, _and_also) >> _all_of
"""As `thing`, of a label that is known or with an article: of "look like spaghetti" nobody knows what is meant."""
_EXCEPT = (
    "[just|only|but please] not|except (for)|apart from|aside from|other than|excluding|besides|barring|sparing|skipping|"
    "ignoring|leaving aside|with the exception of|but not|without|minus|"
    "not including|but (for)|[that|which|who] [is|are] not|save (for)|bar|leaving out|except of|beside from|outside of"
)
_the_biggest = keyword("the") + _which >> (lambda which: _one_of(which, SentenceContext.one, None))
untouched = literal(
    "alone|be|as it is|as they are|as is|as it was|untouched|unchanged|the way it is|the way they are|where it is|where they are|"
    "in peace|normal|original|like it is|like it was|in place|out of it|as before|how it is|in (full|its) (original|normal) "
    "[colors|color|state]|colored|sharp|in focus|crisp|raw|at full (opacity)|fully visible|opaque|solid|([keeps|keep|keeping]) "
    "(on) [moving|going] (on|normally|as before)|[goes|go|carries|carry|moves|move|runs|run] on|continues|continue|[keeps|keep|"
    "keeping|retains] [its|his|her|their] (own|original|current) [size|place|position|color|colors|speed|look]"
) | literal("the same") + unless(literal("for|with|to|on|as|color|size"))
"""Words for a thing that stays as it is."""
_of_cast = here(lambda reading, at: any(map(is_cast, reading.words[at : at + 4])))
_sparing = _say(
    "((,) [but|and|yet|while]) [(please|just|only|do) [leave|leaving|keep|keeping|spare|skip|ignore|leave out|exclude|omit|"
    "omitting] (only|just)|[hold|holding] <_of_cast>|[not|without] [affecting|changing|touching|including]|do not [affect|"
    "change|touch|include]] (the [color|colors] of)"
)
_spared_after = (
    keyword("'s (own) [color|colors]") | untouched | keyword(f"out|there|behind|in [the|this] [{PICTURE}|plate]")
)
_besides = _say(
    "(,) [<except> (on|for|in|to|with) [<_union>|<_the_biggest>]|, not (on|for|in|to|with) <_union>|"
    "<_union> [excepted|aside|excluded|exempted|not included|left out|being left out]]",
    **{"except": keyword(_EXCEPT)},
)
_over = here(
    lambda reading, at: not reading.word(at).isalpha() or reading.word(at) in ("and", "but", "while", "please")
)
spares = _say(
    "(,) [<_sparing> [<_union>|<_the_biggest>] (<_spared_after>)|<_union> [[should|must|may|can] not (be) [change|changed|affected|"
    "touched]|[does|do] not change]|((,) [but|and|while]) <_union> [stays|remains|[may|can|should|must|shall|has to|is to] [stay|"
    "remain]] (<untouched>)] <_over>"
)
"""Whom a command for everything or several leaves as they are, said in a clause of its own: "but keep the dog"."""
everything_but = _say(
    "[<_everything>|<.everything_else>] <_in_scene> [<_besides>|<spares>|not "
    "<_union>]|[what|whatever|all that|anything that] is not <_union>"
)
"""Rule of the thing spared in "everything except the dog": a `Who`."""


@who_of
def _without(context: SentenceContext, kind: Who, rest: Who) -> SelectKind:
    whole = kind(context)  # first, for "the dogs except the left one"
    context.last = And((whole, Not(rest(context))))
    return context.last


besides = here(lambda reading, at: reading.word(at - 1) not in ("everything", "all", "anything")) + _besides
"""Whom a command leaves out, said at its end: "move everything down except the dog"."""
known_noun = either(_part, _known, _modified)
"""A noun alone: the copies of it in "let a second dog follow"."""
thing = either(everything_but >> _all_but, _union, _union + _besides >> _without)
"""Whom a command is about: a `Who`."""


everywhere = NOTHING >> _always(All())
"""Whom a command without an object is for, where that is the whole picture."""
colors = keyword("the colors|colors|all colors|all the colors") >> _always(All())
"""The colours of everything."""


_new = keyword("a|an|some")
there_already = unless(_new) + thing
"""As `thing`, of what is there: "put a hat on the dog" asks for a new one."""
THE_FIRST = keyword("[the first|the original|the real|the old|the other] (one)") | keyword("it|him|her|this one|itself")
"""That which is copied."""


class Place(NamedTuple):
    """A place beside a thing."""

    where: Where
    """Its place beside the thing."""
    other: Who
    """The thing."""


_own_feet = literal("[its|his|her|their] [feet|foot|legs|paws|hooves|wheels]")
_left_or_right = table({f"{side} (side)": side for side in ("left", "right")})
place = either(
    _say("<_beside_what> !<_own_feet> <_neighbour> ![left|right]") >> Place,
    _say("[on|to|at] <_neighbour> ['s|'] <_left_or_right>") >> (lambda other, where: Place(where, other)),
)
"""A `Place`."""
beside_itself = _say("<_beside_what> <THE_FIRST> ![left|right]") >> (lambda where: Place(where, _pronoun("'it'")))
"""The `Place` of a copy beside what is copied."""


def whose(quality: str) -> Rule:
    """Return the rule that makes a `Who` of "the size of the dog", "the dog's size", "its size"."""
    return either(
        ~keyword("the|all|all the") + keyword(quality) + keyword("of|for|on|(out) from|in|out of") + thing,
        keyword("its|their|his|her|this|that") + keyword(quality) >> (lambda *_: lambda context: context.it("'its'")),
        thing + ~keyword("'s|'") + keyword(quality),
    )


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
    *(_moving, _static, _current, _instance, _everybody, silent(_everything), _it, _they, _copy, colour, _which),
    *(everything_else, _other_one, number),
)


def refuse_as_name(called: str) -> None:
    """Raise Refusal for what would be taken for a colour or for another way to say who: "red", "it", "everything"."""
    readings = (Reading(text) for text in (called, f"the {called}"))
    if called.lower() in FUNCTION_WORDS | NO_THINGS or any(
        len(reading.tokens) in _no_name.at(reading, 0) for reading in readings
    ):
        raise Refusal(f"'{called}' cannot be a name, because it means something else in a sentence; choose another.")
