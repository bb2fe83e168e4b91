"""What somebody says before the command: takes back ("delete the pillow, no wait, the lamp"), or remarks ("the pole is in the
way, get rid of it")."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ..language.amounts import amount, direction, distance, number, percent
from ..language.colours import colour
from ..language.grammar import Reading, either, keyword, tokenise
from ..language.lexicon import PICTURE, word_set
from ..language.times import duration, moment, span
from .phrases import familiar, known_thing
from .qualities import made

_TAKEN_BACK = (
    r"(?:[,.;]|\s[-–—]+|\.\.+|…)?\s*\b(?:(?:er+|uh+|um+|oh|sorry|oops|ah),?\s*)*"
    r"(?:no wait|no,? no|wait,? no|hang on|hold on|wait|scratch that|strike that|i mean|i meant|i'm sorry|sorry|correction|"
    r"or rather|or better|make (?:that|it)|no,? make (?:that|it)|actually,?(?: make (?:it|that)| no)?|no)\b\s*"
    r"(?:[,:]|\.+|…)?\s*(?:(?:i mean|i meant|make (?:it|that)|no|rather|actually|it should be|better|sorry|wait|oops)\b,?\s*)*"
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
    of_a_kind = re.match(r"^(.*)\b(?:the|that|this|my) [a-z]+$", first, re.IGNORECASE)
    if of_a_kind and len(behind.tokens) in known_thing.at(behind, 0):  # "the right, no, the left camel"
        yield of_a_kind[1] + last
    spoken = {token.text for token in behind.tokens}
    of_something = any(familiar.at(behind, at) for at in range(len(behind.tokens)))
    if not _SPOKEN_OF & spoken and of_something:  # of whom "it" speaks is in what came before
        yield last


_STATES = (
    r"(?:is|are|was|isn't|aren't|is not|are not|looks?|seems?|feels?|sits?|stands?|hangs?|lies?|hasn't|doesn't|does not|"
    r"don't|do not|[a-z]+s (?:me|us|my|our)|"
    r"hates?|dislikes?|detests?|keeps?|gets?|bothers?|distracts?|annoys?|spoils?|ruins?|blocks?|moves?|drives?|runs?|goes|walks?)"
)
_REMARK = (
    rf"(?:(?:(?:the|that|this|these|those|my|our|its?) )?(?:[\w'-]+ ){{0,4}}?{_STATES}\b.*?|"
    r"(?:i|we|people|nobody|no one|you)(?:'m|'re)? (?:really |just |also )?(?:not|do not|don't|dont|never|can't|cannot|can "
    r"not|can hardly|hate|dislike|needs? (?:that|this)|wants? (?:that|this)|likes?|loves?|have|has|see|notice|think|am|are|"
    r"changed (?:my|our) mind|is)\b.*?|there(?: is| are|'s) .*?|(?:it|that|this|he|she) \w+s (?:me|us|my|our|the (?:eye|"
    r"view|viewer|mood|shot))\b.*?)"
)
_REMARKED = re.compile(
    rf"^(?P<remark>{_REMARK})(?:\s*(?:[,;:.!]+|\s-+|–|—|…)\s*(?:so|and|then|hence|therefore|please)?,?\s*|\s+so "
    r"(?:please )?)(?P<command>[^\s].*)$",
    re.IGNORECASE,
)
"""What says how it is, and the command behind it."""
_IN_OTHER_WORDS = re.compile(
    r"^(?P<remark>.+?)(?:[,;(-]\s*|\s)(?:i\.? ?e\b\.?|that is to say|that is,|in other words|meaning|"
    r"namely),?:?\s+(?P<command>.+?)\)?$",
    re.IGNORECASE,
)
_IN_PICTURE = re.compile(rf"\b(?:in|of|on) (?:the|this) (?:{PICTURE})\b")
_WISH = re.compile(
    r"\b(?:should|must|shall|would|could|can(?! hardly| barely| not|not|['’]t)|want|wish|please|make|let|(?<!used )to be|"
    r"needs? to|has to|have to|except|but|only|until|after|before|second|seconds|frame|frames)\b|\d|%",
    re.IGNORECASE,
)
"""What may be part of the command itself."""


def remarked(sentence: str, known: Mapping[tuple[str, ...], str]) -> Iterator[str]:
    """The command behind a remark, with the thing of the remark in front: "the pole: get rid of it"."""
    match = _IN_OTHER_WORDS.match(sentence) or _REMARKED.match(sentence.strip())
    if match is None or (match.re is _REMARKED and _WISH.search(match["remark"])):
        return
    remark, command = (
        Reading.of(text, tokenise(text), known) for text in (_IN_PICTURE.sub("", match["remark"]), match["command"])
    )
    spoken = _SPOKEN_OF & {token.text for token in command.tokens}
    if not spoken:
        yield match["command"]
    named, at = [], 0
    while at < len(remark.tokens):
        end = max((*familiar.at(remark, at), *known_thing.at(remark, at)), default=at)
        end = end if any(familiar.at(remark, inner) for inner in range(at, end)) else at
        named += [remark.text_of(at, end)] if end > at else []
        at = max(end, at + 1)
    if len(named) == 1:  # of two, "it" may be either
        thing = re.sub(r"^(?:an?|some) ", "", named[0])
        article = "" if re.match(r"(?:the|that|this|these|those|my|our|all|every)\b", thing, re.IGNORECASE) else "the "
        yield f"{article}{thing}: {match['command']}"


_BREAK = re.compile(
    r"(\s*(?:[,;:.!?…()]+(?=\s|$)|\s[-–—]+(?=\s)|\s\(|\s(?=so (?:that )?(?:it|this|that|everything) ))\s*)"
)
_BESIDE = re.compile(
    rf"(?:and |but |because |since |as |well,? )?(?:{_REMARK}|so (?:that )?(?:it|this|that|everything) (?:looks?|seems?|"
    rf"feels?) .*)",
    re.IGNORECASE,
)
"""What is said beside the command and tells how it is, or what it will look like."""


def without_remarks(sentence: str, known: Mapping[tuple[str, ...], str]) -> Iterator[str]:
    """The sentence without a headline ("evening mood: dim the lamp") and what is remarked behind the command."""
    first, *others = _BREAK.split(sentence)
    kept, left_out = [first], False
    for sign, part in zip(others[::2], others[1::2], strict=True):
        if sign.strip() == ":" and kept == [first] and not _means_something(first, known):
            kept, left_out = [part], True
        elif part and _BESIDE.fullmatch(part) and not _WISH.search(part) and _is_harmless(part, known):
            left_out = True
        else:
            kept += [sign, part]
    if left_out:
        yield "".join(kept)


def _means_something(headline: str, known: Mapping[tuple[str, ...], str]) -> bool:
    """Whether a headline says for whom, when or how much what follows is."""
    reading = Reading.of(headline, tokenise(headline), known)
    rules = (familiar, span, amount)
    return bool(_WISH.search(headline)) or any(
        rule.at(reading, at) for rule in rules for at in range(len(reading.tokens))
    )


def _is_harmless(remark: str, known: Mapping[tuple[str, ...], str]) -> bool:
    """Whether a remark is about what is spoken of, or about nothing in the scene."""
    reading = Reading.of(remark, tokenise(remark), known)
    spoken = re.match(r"(?:so|because|since|as)? *(?:that )?(?:it|that|this|he|she|they)\b", remark, re.IGNORECASE)
    return bool(spoken) or not any(familiar.at(reading, at) for at in range(len(reading.tokens)))
