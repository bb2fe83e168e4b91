"""What a refused question may ask: its things and times are certain, its kind is that of questions like it. Only ever asked back.

Things and times give way to the name of their slot; what is left is compared with `phrasings.npz` (`features/phrasings.py`). The
answer is a question of the grammar, as `edit/meaning.py` answers with a sentence.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from ..features import phrasings
from ..features.phrasings import NOTHING, Slot, fill, likeliest
from ..language.grammar import Reading, tokenise
from ..language.lexicon import spellings, word_set
from ..language.times import span
from .cues import CUES

PHRASINGS = Path(__file__).with_name("phrasings.npz")
"""Questions that are known, without what stands in their slots, by kind."""
_NEVER = word_set("not never no except but why only without if")
"""Words with which a question asks something else than what it names."""
_ARTICLES = word_set("the a an any this that my your his her its our some those these")
_PRONOUNS = word_set("it he she they him")
_QUESTIONS = {
    "approach": "does WHO come closer",
    "behind": "what is behind WHO",
    "between": "what is between WHO and OTHER",
    "biggest": "what is the biggest thing|which is bigger, WHO or OTHER",
    "colour": "what color is WHO",
    "compare_size": "which is bigger, WHO or OTHER",
    "compare_speed": "which is faster, WHO or OTHER",
    "count": "how many MANY are there",
    "count_moving": "how many things move",
    "direction": "which way does WHO move",
    "distance": "how far is WHO from OTHER|how far is WHO from CAMERA",
    "distance min": "what is the smallest distance between WHO and OTHER|how close does WHO come to CAMERA",
    "duration": "how long is the clip",
    "farthest": "what is farthest away|which is farthest away, WHO or OTHER",
    "farthest_moment": "when is WHO farthest from OTHER|when is WHO farthest from CAMERA|when is WHO farthest away",
    "fastest_moment": "when is WHO fastest",
    "happens": "what happens|what does WHO do",
    "highest_moment": "when is WHO highest",
    "leave": "when does WHO leave the picture",
    "left_of": "what is left of WHO",
    "list": "what is there",
    "most_moving": "what moves most",
    "moves": "does WHO move",
    "moving": "what moves",
    "nearest": "what is nearest to CAMERA|what is nearest|what is nearest to WHO"
    "|which is nearer, WHO or OTHER|which is nearer to CAMERA, WHO or OTHER",
    "nearest_moment": "when is WHO nearest to OTHER|when is WHO nearest to CAMERA|when is WHO nearest",
    "neighbours": "what is next to WHO",
    "order": "what is the order from left to right",
    "present": "is WHO there",
    "rise": "how high does WHO rise",
    "seen long": "how long is WHO seen",
    "size": "how big is WHO",
    "speed": "how fast is WHO",
    "speed max": "what is the top speed of WHO",
    "speed mean": "what is the average speed of WHO",
    "still": "what stands still",
    "travelled": "how far does WHO move",
    "when_moves": "when does WHO move",
    "when_stops": "when does WHO stop moving",
    "when_visible": "when is WHO seen",
    "where": "where is WHO",
}
"""Kind -> questions that ask it, the first one whose slots are those that were said is taken; a time may always follow."""
_ASKS = {
    r"\b(?:when|moment|instant|(?:what|which) (?:time|frame|second))\b": word_set(
        "farthest_moment fastest_moment highest_moment leave nearest_moment when_moves when_stops when_visible"
    )
    | {"seen long"},
    r"\bwhere\b": word_set("where direction"),
    r"\bcolor\b": word_set("colour"),
    r"\bhow many\b": word_set("count count_moving"),
}
"""Words -> the kinds of question that they ask for."""


def masked(text: str, labels: Collection[str]) -> tuple[str, tuple[Slot, ...]]:
    """The words of a question in lower case with the names of its slots in place of what stands there, and the slots."""
    reading = Reading.of(
        text, tokenise(text), {tuple(form.split()): form for label in labels for form in spellings(label)}
    )

    def ends_at(at: int) -> dict[str, int]:
        ends = {"TIME": [end for end, (time,) in span.at(reading, at).items() if time.kind not in ("always", "length")]}
        start = at + (reading.word(at) in _ARTICLES)
        ends["WHO"] = [
            end
            for end in range(start + 1, min(start + reading.longest, len(reading.tokens)) + 1)
            if any(tuple(form.split()) in reading.known for form in spellings(" ".join(reading.words[start:end])))
        ] or ([at + 1] if reading.word(at) in _PRONOUNS else [])
        ends["CAMERA"] = [] if reading.word(at) in ("in", "to") else [*CUES["camera"].at(reading, at)]
        return {kind: max(found) for kind, found in ends.items() if found}

    def slot(kind: str, at: int, end: int) -> Slot:
        return Slot(kind, reading.text_of(at + (kind == "WHO" and reading.word(at) in _ARTICLES), end))

    return phrasings.masked(reading.words[: len(reading.tokens)], ends_at, slot)


def meant(text: str, labels: Collection[str]) -> Iterator[str]:
    """Questions that a refused one may be, best first, not all of them grammatical; none where that is not certain.

    `labels`: names of things that may be asked about.
    """
    phrasing, slots = masked(text, labels)
    if _NEVER.isdisjoint(phrasing.split()) and "n't" not in phrasing:
        kind = likeliest(PHRASINGS, text, phrasing)
        if kind != NOTHING and all(kind in kinds for words, kinds in _ASKS.items() if re.search(words, phrasing)):
            yield from questions(kind, slots)


def questions(kind: str, slots: Sequence[Slot]) -> Iterator[str]:
    """The questions of the grammar of a kind with slots; none where a thing or a time would be left out."""
    phrases, times = (list(dict.fromkeys(slot.words for slot in slots if slot.kind == one)) for one in ("WHO", "TIME"))
    things = [words for words in phrases if words not in _PRONOUNS] or phrases
    if len(things) > 2 or len(times) > 1:
        return
    named = [words if words in _PRONOUNS else f"the {words}" for words in things]
    values = dict(zip(("WHO", "OTHER"), named, strict=False))
    values |= dict(zip(["MANY"], things, strict=False))
    if any(slot.kind == "CAMERA" for slot in slots):
        values["CAMERA"] = "the camera"
    for template in _QUESTIONS[kind].split("|"):
        if question := fill(template, values, ("CAMERA", "WHO" if "MANY" in template else "MANY")):
            yield " ".join([question, *times])
