"""What a question wants to know: a closed grammar of English questions that a scene can answer by computing.

A question is a bag of typed phrases in any order: cues ("how far", "moves"), things, a time, and fillers that add nothing.
`cues.ROWS` says which cues ask for what. Every word belongs to some phrase, or the question is refused: half an understanding
gives an answer to another question.
"""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import F4xError
from ..language.amounts import number
from ..language.grammar import (
    NOTHING,
    Reading,
    Rule,
    covers,
    either,
    generated,
    here,
    matches_of,
    table,
    word_if,
    words_of_label,
)
from ..language.idle import BINDING, EMPTY, PREPOSITIONS
from ..language.lexicon import (
    CONTRACTIONS,
    FUNCTION_WORDS,
    SPELLING,
    WHICH,
    is_adverb,
    is_slip,
    label_of,
    misspelt,
    singular,
    spellings,
    word_set,
    written,
)
from ..language.notation import Notation
from ..language.refusal import Doubt, Slip
from ..language.times import END, START, Clip, Span, no_such_time, span
from ..language.verbs import IMPERATIVES
from .cues import COLOURS, CUES, ROWS, WORDS, cue

INSTEAD = (
    "a scene can tell where, when, how far, how fast, how big, how many, of which color and in which order (more by a model: "
    "--endpoint or --model)"
)
"""What a refusal says."""


class Unanswerable(F4xError):  # noqa: N818  # nothing went wrong
    """A question that cannot be answered by computing."""


@dataclass(frozen=True)
class Asked:
    """A question that was understood."""

    kind: str
    """One of those that `cues.ROWS` begin with; `what_is`: which word is meant by what is selected."""
    things: tuple[str, ...] = ()
    """What it is about; empty: whatever there is, or what moves."""
    span: tuple[float, float] | None = None
    """First and last clip frame that it is about; None = the clip."""
    side: str = ""
    """left, middle or right, where it asks whether a thing is there."""
    polar: bool = False
    """True if it wants yes or no."""
    negated: bool = False
    """True if yes means that it is not so: "Does it never move?"."""
    manner: str = ""
    """The verb, where it asks for more than motion: "Does it fly?"; the relation or the order, where it asks for one."""
    extreme: str = ""
    """min, max or mean, where it asks for one of many moments."""
    other: tuple[str, ...] = ()
    """The second of two things, also the last of `things`; empty with a kind that compares: the camera."""
    among: str = ""
    """The first of `things`, where the question is about the single ones of a kind: "Which wagon is nearest?"."""
    but: tuple[str, ...] = ()
    """What is left out: "What is the biggest thing apart from the wall?"."""
    at_least: float = 0.0
    """The least number of them for a yes: "Is there more than one dog?"."""

    def yes(self, so: bool) -> str:
        """Return Yes or No where one is wanted; `so`: what it asks about, without the negation, is true."""
        return "" if not self.polar else "Yes" if so != self.negated else "No"


_GAZE = (
    r"\b(?:which|what) (?:way|direction|side)\b.*\b(?:look|fac|point)|\bwhere (?:is|are|does)\b.*\b(?:look|"
    r"fac)(?:s|es|ing|ed)?\b|\b(?:look|fac)(?:s|es|ing|ed)? (?:to|toward|at|left|right|away|up|down|us|me)\b"
)
SUBJECTS = (
    (_GAZE, "which way something looks or faces, only which way it moves"),
    (r"\bwhy\b|\breason|\bhow come\b", "why something happens"),
    (
        r"\bpaint|\btexture|\bmade of\b|\bmaterial|\bheavy|\bweigh|\bhow old\b|\bbrand|\bbreed",
        "what something is made of, weighs or is called",
    ),
    (r"\bcamera|\blens|\bfocal|\bshutter|\bexposure|\bzoom", "what the camera was set to or did beyond moving"),
    (r"\bthink|\bfeel|\bsay\b|\bsays\b|\bsound|\bhear|\bwrit", "what is thought, said or written"),
    (r"\bwhat will\b|\bhappens? next\b|\btomorrow\b", "what comes after the clip"),
    (
        r"\bwearing\b|\bholding\b|\bcarrying\b|\beating\b|\bdoing\b|^what (?:does|do|did|is|are) \S",
        "what somebody does beyond moving",
    ),
    (r"^(?:and )?who\b|\bwhose\b|\bname\b", "who somebody is"),
    (r"\bhow many\b|\bnumber of\b|\bcount\b", "how many of a kind there are"),
)
"""(pattern, what it asks for that nobody can compute); the first that fits is told."""

_NO_NAMES = (
    FUNCTION_WORDS
    | WORDS
    | word_set("s frame frames second seconds minute minutes now everything everybody everyone nothing nobody")
)
"""Words that no name of a thing holds …"""
_NOUNS_TOO = word_set(
    "fly track light path course slide swing drive float stage water floor ground surface hand screen plate sign"
)
"""… unless an article stands before them …"""
ONE_OF_SEVERAL = {word: which for words, which in WHICH.items() for word in words.split("|")}
"""… or that tell which of several a known one behind them is …"""
_BEFORE = word_set("front back left right top bottom middle other big small large tall moving fast") | COLOURS
"""… or the noun behind them."""
_NO_ENDING = re.compile(
    r"(?!bed$|red$|seed$|sled$|shed$|weed$|reed$|speed$).{2,}ed|(?!building|swing|string|ring|king|wing|thing|ceiling|painting"
    r"|clothing|railing|awning|spring|pudding|duckling|sapling|wedding|earring).{3,}ing"
)
"""A word that no name ends with: "parked", "looking"."""
_PRONOUNS = word_set("it they them he she him her")
_IT = _PRONOUNS | word_set("this that these those its their his")
"""Words for what was named just before, or is selected."""
_THE_SELECTION = re.compile(
    r"\b(?:(?:the|this|my) (?:current )?selection|(?<=\w )what is selected|the selected (?:thing|one|object))\b"
)
"""More words for what is selected."""
_EVERYTHING = word_set("everything everybody everyone things objects")
_MOST_WORDS = 4
"""Words of a name."""
_ARTICLE = cue(
    "the (two)|a|an|any|some|this|that|these|those|my|your|our|his|her|its|their"
    "|all (of) (the)|each|every|both (of) (the)|single|of the"
)


_VERBS = (IMPERATIVES | (CUES["manner"].first or frozenset()) | word_set("work")) - FUNCTION_WORDS
"""Words that before a thing say what it is for: "drift car"."""


@dataclass
class _Shown(Clip):
    """A clip and the words for what is in it."""

    known: dict[tuple[str, ...], str] = field(default_factory=dict)
    """Words of a label -> the label."""


def _label_end(reading: Reading, at: int) -> int:
    """Return the end of the longest label that begins at a word; 0 where none does."""
    words = reading.words[at : at + reading.longest]
    whole = (n for n in range(len(words), 0, -1) if (*words[: n - 1], singular(words[n - 1])) in reading.known)
    return next((at + n for n in whole), 0)


def _name_at(reading: Reading, at: int) -> Iterator[tuple[int, str]]:
    """Yield (end, name) of those that begin at a word, the longest first; `it` for a pronoun."""
    begins = [at, *_ARTICLE.at(reading, at)]
    for start in sorted(begins, reverse=True):
        ends, label = [], _label_end(reading, start)
        for end in range(start, min(len(reading.tokens), start + 2 * _MOST_WORDS)):
            word = reading.word(end)
            owner = word == "'s" and end > start
            if not owner and (not word.isalpha() or is_adverb(word)):
                break
            first = end == start > at  # an article stands before it
            compound = first and word in _VERBS and _label_end(reading, end + 1)  # "the race horse"
            if end + 1 < (compound or label):
                continue
            if word in _NO_NAMES and not (
                owner
                or end + 1 == label
                or word in _BEFORE
                or (first and (word in _NOUNS_TOO or word.endswith("ing")))
                or (first and word in ONE_OF_SEVERAL and _label_end(reading, end + 1))
                or (end > start and word == "one")
            ):
                break
            if not owner and (word not in _BEFORE or (first and word in COLOURS)) and not _NO_ENDING.fullmatch(word):
                ends.append(end + 1)
        for end in reversed(ends):
            name = reading.text_of(start, end).replace(" '", "'")
            yield end, name
            for whole in _of_the.at(reading, end):  # "the roof of the house"
                for last, (owner,) in _name.at(reading, whole).items():
                    yield last, f"{owner}'s {name}"
    if reading.word(at) in _IT:
        yield at + 1, "it"
    elif reading.word(at) in _EVERYTHING:
        yield at + 1, ""


def _names_at(reading: Reading, at: int) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield (end, names) of the lists that begin at a word, the longest first: "the dog, the cat or a bird"."""
    found: list[tuple[int, tuple[str, ...]]] = []
    front = list(_name.at(reading, at).items())
    while front:
        found += front
        front = [
            (last, (*names, values[0]))
            for end, names in front
            for middle in _listing.at(reading, end)
            for last, values in _name.at(reading, middle).items()
        ]
    for end, names in sorted(found, key=lambda one: (-one[0], len(one[1]))):
        yield end, tuple(dict.fromkeys(name for name in names if name))


_name = generated(_name_at)
_of_the = cue("of (the|my|this|that|his|her|its)")
_doing = cue("is|are|was|were") + word_if(
    lambda reading, at: reading.word(at).endswith("ing") and reading.word(at) not in WORDS
)
"""What somebody does that no cue knows: "are watching"."""
_listing = cue("and|or|,|, and|, or|versus|vs|and of")
_names = generated(_names_at)
_spot = cue("on|onto|in|inside|under|underneath") + _name
"""Where somebody is that nobody can compute: "on the bed"."""
_say = Notation(ChainMap(globals(), CUES), WORDS)
_whom = _say.table({"<camera>": (), "<_names>": lambda names: names})
_end = _say.table({"<camera>": (), "<_name>": lambda name: (name,)})


def _span_at(reading: Reading, at: int) -> Iterator[tuple[int, Span]]:
    for end, (found,) in span.at(reading, at).items():
        alone = "only" in (reading.word(at), reading.word(end - 1))  # what holds at other times is not computed
        if found.kind not in ("always", "length", "later") and reading.word(end - 1) != "here" and not alone:
            yield end, found


def _beside(name: str, links: str = "") -> Rule:
    """Return the rule of a cue with the things behind it: (value of the cue, names)."""
    link = ~cue(links) if links else NOTHING
    return either(CUES[name] + link + _whom >> (lambda *found: (found[0] if len(found) > 1 else name, found[-1])))


_before_article = here(lambda reading, at: reading.word(at) in ("the", "a", "this", "that", "us"))
"""True if a thing follows with its article: "nearest the tree", which "the nearest tree" is not."""


def _aside_at(reading: Reading, at: int) -> Iterator[tuple[int, None]]:
    """Yield the end of words that add nothing: a tag behind the question, a remark before or behind it."""
    words = [token.text for token in reading.tokens]
    if len(words) in CUES["tag"].at(reading, at):
        yield len(words), None
    begin = at + (at > 0 and words[at] == ",")
    reminds = CUES["remark"].at(reading, begin) and words[begin : begin + 2] != ["i", "mean"]
    if (at == 0 or begin > at or words[at] == "because") and reminds:
        ends = [end for end in range(begin, len(words)) if words[end] == ","] if at == 0 else []
        for end in (*ends, len(words)):
            if _INTERROGATIVES.isdisjoint(words[begin:end]):
                yield end, None


_INTERROGATIVES = word_set("when where how what which who if whether tell")
"""Words with which a remark would be part of the question."""
_nearer = here(lambda reading, at: reading.word(at - 1) in ("nearer", "closer", "nearest", "closest"))
_asks_what = here(lambda reading, at: reading.word(0) in ("what", "who", "which"))
_side_of = table({f"'s {side} (hand) (side)": f"{side} of" for side in ("left", "right")}, vocabulary=WORDS)
_on_side = CUES["on-side"] >> (lambda: "left of")
_slots: dict[str, Rule] = {
    **CUES,
    "time": either(
        _say.table(
            {
                "(in|at|on|during) the (very) last frame|when [it|the clip|the video] [ends|is over]": Span(
                    END, END, "moment"
                ),
                "when [it|the clip|the video|the shot|the scene] [begins|starts|opens]": Span(START, START, "moment"),
            }
        ),
        generated(_span_at),
    ),
    "owner": _say("[has|have|does|do|did] <_names> [got|have|had]"),
    "what-is": cue("what is|what are|which is|which are|what was|what were"),
    "thing": _say("(of|for|by|about) <_names> ('s|')"),
    "who": _say.table(
        {"<what>": (), "[which|what|which of|which one of|what kind of|which of all] <_names>": lambda of: of}
    ),
    "other": _say("[to|from|of|than|and|-|with|toward|compared to|or] <_whom>"),
    "than": _say("[than|as] <_names>"),
    "doing": generated(lambda reading, at: ((end, reading.word(end - 1)) for end in _doing.at(reading, at))),
    "spot": generated(lambda reading, at: ((end, reading.text_of(at, end)) for end in _spot.at(reading, at))),
    "us": _say("[to|from|of|for|toward|<_nearer>] <camera>"),
    "pair": _say.table(
        {
            "[between|in between|from] <_end> [and|to] <_end>": lambda one, two: one + two,
            "[between|in between] <_names>": lambda names: names,
        }
    ),
    "but": _say("<but> <_names>"),
    "more-than": cue("more than") + number >> (lambda x: x + 1) | cue("at least|as many as") + number,
    "place-of": either(
        _beside("place"),
        _say("<_asks_what> [on|upon] <_before_article> <_names>") >> (lambda names: ("near", names)),
        _say("[on|to|at] <_names> <_side_of>") >> (lambda names, relation: (relation, names)),
    ),
    "place-or": _say("[<_on_side>|<place>] or <place> <_names>") >> (lambda one, two, names: (one, names)),
    "passes-by": _beside("passes"),
    "closing-to": either(
        _beside("closing", "to|from"), _say("<closing> (each other|one another|together)") >> (lambda how: (how, ()))
    ),
    "compared-to": _beside("compared"),
}


@dataclass(frozen=True)
class _Row:
    """One line of `cues.ROWS`."""

    kind: str
    polar: bool
    options: dict[str, str]
    """`extreme`, `manner`, or `at` which end of the clip; `says`: yes means that it is not so."""
    slots: tuple[str, ...]
    """What it may hold."""
    needed: frozenset[str]
    """Those of them without which it is not asked."""


def _rows() -> Iterator[_Row]:
    for line in ROWS.replace("\n    ", " ").strip().splitlines():
        head, _, ways = line.partition(":")
        kind, *more = head.removeprefix("polar ").split()
        options = dict(word.split("=") for word in more)
        for way in ways.split("|"):
            words = way.split()
            slots = [word.rstrip("?") for word in words]
            slots += ["time"] * (kind not in CLIP_FACTS) + ["what-is"] * (not _NOUN_CUES.isdisjoint(words))
            needed = frozenset(word for word in words if not word.endswith("?"))
            yield _Row(kind, head.startswith("polar "), options, tuple(slots), needed)


_NOUN_CUES = word_set("fast gap big where path duration which-color rate order least how-many far most-far")
"""Cues that may be nouns: "what is the speed"."""
CLIP_FACTS = ("frames", "long", "rate", "camera")
"""Kinds of question about the clip itself; `camera`: how it moved."""
_ROWS = tuple(_rows())
_EMPTY, _LOOSELY, _UNKNOWN = 3, 20, 100
"""Costs of a word that adds nothing, of such a word, and of any word."""
_aside = generated(_aside_at)
_BESIDE = {"in front of": "in_front", "left of": "left_of", "right of": "right_of", "near": "neighbours"}
"""Relation -> the kind of question what stands so to a thing."""
_BESIDE_ALL = {"in front of": "nearest", "behind": "farthest"}
"""The same of everything."""
_MANY = word_set("nearest farthest biggest brightest most_moving compare_speed order count_moving still")
"""Kinds that can be about the single ones of a kind."""
ONE_BY_ONE = ("rise", "highest_moment", "fastest_moment", "slowest_moment", "path", "when_turns", "stops")
"""Kinds that are answered for each of several things."""
_TWO = word_set("relation compare_size compare_speed")
_ASKING = r"(?:when|where|how|what|which|who|is|are|do|does|did|can|in what|in which|at what|at which)"
_ASKING_WORDS = {*_NO_NAMES, *SPELLING} - {"looking"}  # in "what am I looking at?" alone


def plainly(question: str, selected: bool = False) -> str:
    """Return a question in lower case, in the language's own spelling, without courtesies; `selected`: "the selection" is it."""
    text = " ".join(written(question).lower().replace("’", "'").split())
    text = re.sub(r"[a-z]+", lambda word: " ".join(CONTRACTIONS.get(word[0], (SPELLING.get(word[0], word[0]),))), text)
    text = _THE_SELECTION.sub("it", text) if selected else text
    return re.sub(r"[?!.,;:\s]+$", "", text)


def read_question(
    question: str, fps: float, frames: int, selected: str = "", labels: Collection[str] = ()
) -> tuple[Asked, ...]:
    """Parse `question`, one or several joined by "and", about a clip of `frames` frames; `selected`: what "it" is at first.
    `labels`: names of things, to tell which one has its letters swapped.

    Raises F4xError: a time beyond the clip; `Unanswerable`: what is not understood whole; `Doubt`: what may be misspelt, or
    is like another question.
    """

    def called(words: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(label_of(word, labels) for word in words)

    clip = _Shown(fps, frames, known={words_of_label(label): label for label in labels})
    text = plainly(question, bool(selected))
    parts = re.split(rf"[?!;]+ *|\. |,?(?<!^who) and (?={_ASKING}\b)", text)
    understood: list[Asked] = []
    for part in parts:
        it = (understood[-1].things if understood else ()) or ((selected,) if selected else ())
        try:
            understood += _read(part, clip, it)
        except Doubt as doubt:
            raise type(doubt)(doubt.reason, text.replace(part, doubt.instead)) from doubt
    understood = [
        replace(asked, things=called(asked.things), other=called(asked.other), but=called(asked.but))
        for asked in understood
    ]
    _doubt_swapped(text, {word for asked in understood for thing in asked.things for word in thing.split()}, labels)
    return tuple(understood)


def _doubt_swapped(text: str, words: Collection[str], labels: Collection[str]) -> None:
    """Raise Doubt where one of the `words` is a label with its letters in another order."""
    known = {form for label in labels for form in spellings(label)}
    for word in words:
        meant = next((label for label in sorted(known) if sorted(label) == sorted(word)), word)
        if known.isdisjoint(spellings(word)) and meant != word:
            raise Doubt(f"Nothing is called '{word}'; did you mean '{meant}'?", text.replace(word, meant))


def _read(text: str, clip: _Shown, it: tuple[str, ...]) -> list[Asked]:
    if re.search(_GAZE, text) and not re.search(r"\b(?:i|we|you)\b", text):  # to look is not to move
        raise _refusal(text, clip, it)
    asked = _understood(text, clip, it) or (_understood(f"{text} it", clip, it) if it else None)
    if asked is None:
        instead = re.sub(r"[a-z]{3,}", lambda m: m[0] if m[0] in _ASKING_WORDS else _mended(m[0]), text)
        if instead != text and _understood(instead, clip, it, _LOOSELY):
            sure = all(
                one == other or is_slip(one, other) for one, other in zip(text.split(), instead.split(), strict=True)
            )
            raise (Slip if sure else Doubt)(f"I do not understand '{text}'; did you mean '{instead}'?", instead)
        raise _refusal(text, clip, it)
    if asked.kind in ONE_BY_ONE and not asked.other:
        return [replace(asked, things=(thing,)) for thing in asked.things] or [asked]
    return [asked]


def _mended(word: str) -> str:
    """Return the word of questions that was probably meant, or `word` where it is another one with an ending: "party"."""
    meant = misspelt(word, _ASKING_WORDS)
    return word if meant is None or word in (meant + "y", meant + "ing", meant + "ed", meant + "er") else meant


def _understood(text: str, clip: _Shown, it: tuple[str, ...], below: int = _UNKNOWN) -> Asked | None:
    """Return the likeliest question, of those that cost less than `below`."""
    text = re.sub(r"^((?:and |but |so )?(?:is|are|was|were|do|does|did|has|have|can|could))n't\b", r"\1", text)
    reading = Reading(text, clip.known)  # "Isn't it moving?" wants the same yes as "Is it moving?"
    cost, asked = next(_readings(reading, clip, it), (below, None))
    verb = asked and any(
        re.search(rf"\b(?:do|does|did) (?:\w+ )?{re.escape(thing)}$", text) for thing in asked.things if " " in thing
    )
    return asked if cost < below and not verb else None  # "the man live" is no name: "does" needs a verb


def _readings(reading: Reading, clip: _Shown, it: tuple[str, ...]) -> Iterator[tuple[float, Asked]]:
    """Yield (cost, question) of every row that covers the sentence, the cheapest first."""
    matches = matches_of(_slots, frozenset(), reading)
    gaps = [_gaps(reading, at) for at in range(len(reading.tokens))]
    found_by = (
        (row, covers({slot: matches[slot] for slot in row.slots if slot in matches}, row.needed, gaps)) for row in _ROWS
    )
    fitting = [(row, found[len(gaps)][0]) for row, found in found_by if len(gaps) in found]
    for row, (cost, found, _) in sorted(fitting, key=lambda one: (one[1].cost, -len(one[0].needed))):
        if asked := _asked(row, found, clip, it):
            yield cost - len(row.needed) / 10, asked


def _gaps(reading: Reading, at: int) -> dict[int, int]:
    """Return the ends of words at `at` that add nothing and their costs: the fewer are left out, the likelier a reading."""
    ends = {end: end - at for end in (*_aside.at(reading, at), *CUES["filler"].at(reading, at))}
    word = reading.word(at)
    if word in EMPTY and at + 1 < len(reading.tokens):  # at its end it asks: "what does it look like"
        ends.setdefault(at + 1, _EMPTY)
    verb = 2 if reading.word(1) in ("is", "are", "was", "were") else 1
    asks = at == 0 and word in ("who", "what") and CUES["manner"].at(reading, verb)  # "who is driving the car"
    if word in BINDING and not asks and not (word in PREPOSITIONS and _name.at(reading, at + 1)):
        ends.setdefault(at + 1, _LOOSELY)
    return ends | dict.fromkeys(CUES["inside"].at(reading, at), 1)


def _asked(row: _Row, found: dict[str, Any], clip: _Shown, it: tuple[str, ...]) -> Asked | None:
    """Return the question of a row whose slots are filled; None where they do not go together."""
    if row.kind == "what_is":
        return Asked(row.kind, it) if it else None
    joined = next((found[slot] for slot in _JOINED if slot in found), ("", ()))
    pair = found.get("pair", ())
    who, thing = found.get("who") or (), found.get("thing", ()) or tuple(filter(None, [row.options.get("thing")]))
    if who and len(thing) == 1:
        return None
    other = (*found.get("other", ()), *found.get("than", ()), *pair[1:], *joined[1])
    named = (*who, *thing, *pair[:1], *other)
    things = _resolved(named, it)
    other = things[len(things) - len(other) :] if len(things) >= len(other) else ()
    if row.kind == "distance" and len(things) < 2:
        if not things:
            return None
        things = things if other == things else (*things[0].split("-"), *other)  # "the dog-bush distance"
    manner = row.options.get("manner") or joined[0] or next((found[slot] for slot in _MANNERS if found.get(slot)), "")
    polar, negated = row.polar and " or " not in manner, row.polar and ("not" in found or "no" in found)
    negated = negated != ("says" in row.options)
    kind = _OPPOSITE.get((row.kind, manner), row.kind)
    if kind == "@place":
        kind, manner = (_BESIDE.get(manner, manner) if things else _BESIDE_ALL.get(manner, "")), ""
    elif kind == "still" and polar:
        kind, negated = "motion", not negated
    near, several = kind in ("nearest", "farthest"), len(things) > 1
    if things == other and not near:
        other = ()
    they = kind in ("nearest_moment", "farthest_moment") and "it" in named and "other" not in found
    if several and not other and (they or near or kind in _TWO | {"distance"}):
        other = things[-1:]
    alone = not several and manner not in _MOST and (kind in _TWO or (polar and near))
    if not kind or alone or (row.kind in _NEEDS_A_THING and not it and "it" in named):
        return None
    among = (*who, *thing) if kind in _MANY and not (polar or pair or (other and not near)) else ()
    among = things[:1] if near and other and len(things) > 2 else among
    span = ((clip.frames - 1.0) * (row.options["at"] == "end"),) * 2 if "at" in row.options else None
    return Asked(
        kind,
        things,
        _frames(found["time"], clip) if "time" in found else span,
        found.get("side", "") or found.get("sideways", ""),
        polar,
        negated,
        manner,
        row.options.get("extreme", "") or found.get("extreme", ""),
        other,
        among[0] if len(among) == 1 and among != ("it",) else "",
        found.get("but", ()),
        found.get("more-than", 0.0),
    )


_JOINED = ["place-of", "place-or", "passes-by", "closing-to", "compared-to"]
_MANNERS = ["manner", "order-by", "biggest", "brightest", "speediest", "bigger", "faster", "color", "place"]
_MANNERS += ["farther-aside", "doing", "spot"]
"""Slots, the first that is filled: what says in which manner, or by which relation."""
_OPPOSITE = {("fastest_moment", "slowest"): "slowest_moment", ("farthest_moment", "smallest"): "nearest_moment"}
"""(kind, extreme that is asked for) -> the kind that it is."""
_NEEDS_A_THING = word_set(
    "@place neighbours between relation size colour count compare_size biggest seen seeing lasting"
)
"""Kinds that nothing stands in for where "it" stands for nothing."""
_MOST = ("fastest", "slowest")


def _resolved(things: tuple[str, ...], it: tuple[str, ...]) -> tuple[str, ...]:
    """Return `things` with what "it" and "the back one" stand for."""
    names: list[str] = []
    for thing in things:
        first, _, last = thing.rpartition(" ")
        if last in ("one", "ones") and names:
            thing = f"{first} {names[0].split()[-1]}".strip()
        names += it if thing == "it" else (thing,)
    return tuple(dict.fromkeys(names))


def _refusal(text: str, clip: _Shown, it: tuple[str, ...]) -> F4xError:
    """Return why nothing is computed: the unknown word, or the subject of the question."""
    words = re.findall(r"[^\W\d_]+", text)
    if not it and not _PRONOUNS.isdisjoint(words) and _understood(text, clip, ("it",)):
        return Unanswerable(f"Nothing is selected or was named before that 'it' could be; {INSTEAD}.")
    subject = next((what for pattern, what in SUBJECTS if re.search(pattern, text)), "")
    if limit := re.search(r"\b(?:no|not|never|only)\b", text):
        subject = subject or f"what '{limit[0]}' asks for here"
    known = {word for label in clip.known for word in label}
    last = [word for word in words if word not in _ASKING_WORDS | known][-1:]
    strange = next((word for word in words if is_adverb(word)), last[0] if last and text.endswith(last[0]) else "")
    if not subject and strange:
        return Unanswerable(f"I do not know what '{strange}' means here; {INSTEAD}.")
    return Unanswerable(f"Computing from the scene cannot tell {subject or 'that'}; {INSTEAD}.")


def _frames(span: Span, clip: _Shown) -> tuple[float, float]:
    """Return the first and last clip frame of a span, of a moment twice the same."""
    last = clip.frames - 1
    first = span.start.resolve(clip)
    if span.kind == "by" and span.end:  # where it has got to by then
        span = Span(span.end, span.end, "moment")
        first = span.start.resolve(clip)
    final = first if span.kind == "moment" else last if span.end is None else span.end.resolve(clip)
    for frame, moment in ((first, span.start), (final, span.end or span.start)):
        if not 0 <= frame <= clip.frames or (frame > last and not (moment.seconds or moment.clip)):
            raise F4xError(no_such_time(moment, clip))
    first, final = min(first, last), min(final, last)
    return min(first, final), max(first, final)
