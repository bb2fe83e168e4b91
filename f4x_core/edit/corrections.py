"""What somebody takes back while speaking: "delete the pillow, no wait, the lamp"; and the order in which things are to be done."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ..language.amounts import amount, direction, distance, number, percent
from ..language.colours import colour
from ..language.grammar import Reading, either, lit, tokenise
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
_KINDS = (
    either(known_thing),
    either(colour),
    either(span, lit("at") + moment),
    either(duration, percent, number + lit("times|x"), lit("frame|second") + number),
    either(moment),
    either(distance, amount),
    either(direction, lit("left|right|up|down|top|bottom")),
    either(number),
    either(made),
)
"""Kinds of phrases, of which the last one that was said is replaced by one of the same kind."""
_ORDERS = (
    (
        r"^(?:do not|don't|dont|never) [a-z]+ (?P<x>(?:the |my |that |this )?[\w' ]+?)[,;.]? "
        r"(?:but |just |only |instead |rather )+(?P<a>[a-z]+ .+)$",
        r"leave \g<x> alone and \g<a>",
    ),
    (
        r"^(?P<a>.*\btoo\b.+?)[,.;]+ (?:please |so )?(?:tone|turn|bring|dial|take|fix|correct|change|lower|reduce)\b"
        r"(?: (?:it|that|this|them))?(?: down| up| back)?(?: a bit| a little)?[.!]*$",
        r"\g<a>",
    ),
    (r"^(?:before|prior to) (?:you |we |i )?(?P<b>.+?), (?:please |first )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (r"^(?P<b>.+?),? but (?:only |just )?(?:after|once) (?:you |we )?(?:have |'ve )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (
        r"^(?:after|once) (?:you have|you've|we have|you|we|that,?) (?P<a>[a-z]+ .+?), (?P<b>[a-z]+ .+)$",
        r"\g<a>. \g<b>",
    ),
    (r"^(?P<b>.+?),? after (?:you |we )(?:have |'ve )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (r"^(?P<b>.+?),? but first,? (?P<a>.+)$", r"\g<a>. \g<b>"),
)
"""What is done about a complaint that is named again, and sentences whose second part is done first."""
_ORDER_PATTERNS = tuple((re.compile(pattern, re.IGNORECASE), said) for pattern, said in _ORDERS)


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
        said = [(end, at) for at in range(len(before.tokens)) for end in kind.at(before, at) if end > at]
        if said:
            end = max(said)[0]
            at = min(start for stop, start in said if stop == end)
            tail = first[before.tokens[end - 1].end :]
            yield f"{first[: before.tokens[at].start]}{last}{tail}"
    yield last


def in_order(sentence: str) -> Iterator[str]:
    """The sentence with what is to be done first in front: "before you delete the fence, make the horse gray"."""
    for pattern, said in _ORDER_PATTERNS:
        if match := pattern.match(sentence.strip()):
            yield match.expand(said)
