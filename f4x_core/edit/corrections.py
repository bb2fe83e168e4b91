"""What somebody takes back while speaking: "delete the pillow, no wait, the lamp"."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ..language.amounts import amount, direction, distance, number, percent
from ..language.colours import colour
from ..language.grammar import Reading, either, keyword, tokenise
from ..language.lexicon import word_set
from ..language.times import duration, moment, span
from .phrases import known_thing
from .qualities import made

_TAKEN_BACK = (
    r"(?:[,.;]|\s[-–—]+|\.\.+|…)?\s*\b(?:(?:er+|uh+|um+|oh|sorry|oops|ah),?\s*)*"
    r"(?:no wait|no,? no|wait,? no|hang on|hold on|wait|scratch that|strike that|i mean|i meant|i'm sorry|sorry|correction|"
    r"or rather|or better|make (?:that|it)|no,? make (?:that|it)|actually,?(?: make (?:it|that)| no)?|no)\b\s*"
    r"(?:[,:]|\.+|…)?\s*(?:(?:i mean|i meant|make (?:it|that)|no|rather|actually|it should be|better)\b,?\s*)*"
)
_CORRECTION = re.compile(rf"^(?P<first>.+?){_TAKEN_BACK}(?P<last>\S.*)$", re.IGNORECASE)
_AFTERTHOUGHT = re.compile(
    r"^(?P<first>.+?)[,;.]\s*(?:no,?\s*)?(?P<last>[\w #%]+?),? (?:i mean|i meant|rather|sorry)\.?$", re.IGNORECASE
)
_SURE = re.compile(
    r"\b(?:wait|scratch|strike|mean|meant|sorry|correction|rather|actually|oops|er|uh|um|hang on|hold on)\b|\bno\b,",
    re.IGNORECASE,
)
"""What makes it sure that something is taken back: "the one with no hat" does not."""
_SPOKEN_OF = word_set("it him her them its his their")
_KINDS = (
    known_thing,
    colour,
    either(span, keyword("at") + moment),
    either(duration, percent, number + keyword("times|x"), keyword("frame|second") + number),
    moment,
    either(distance, amount),
    either(direction, keyword("left|right|up|down|top|bottom")),
    number,
    made,
)
"""Kinds of phrases, of which the last one that was said is replaced by one of the same kind."""


def corrected(sentence: str, known: Mapping[tuple[str, ...], str]) -> Iterator[str]:
    """What the sentence comes to when what is taken back is left out, likeliest first; nothing where nothing is."""
    match = _CORRECTION.match(sentence) or _AFTERTHOUGHT.match(sentence)
    if match is None or not _SURE.search(sentence):
        return
    first, last = match["first"].strip(" ,.;-–—…"), match["last"].strip(" ,.;-–—…!")
    before, behind = (Reading.of(text, tokenise(text), known) for text in (first, last))
    for kind in _KINDS:
        if len(behind.tokens) not in kind.at(behind, 0):
            continue
        places = [(end, at) for at in range(len(before.tokens)) for end in kind.at(before, at) if end > at]
        if places:
            end = max(places)[0]
            at = min(start for stop, start in places if stop == end)
            tail = first[before.tokens[end - 1].end :]
            yield f"{first[: before.tokens[at].start]}{last}{tail}"
    if not _SPOKEN_OF & {token.text for token in behind.tokens}:  # of whom "it" speaks is in what came before
        yield last
