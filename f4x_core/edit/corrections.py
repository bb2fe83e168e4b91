"""What somebody says before the command: takes back ("delete the pillow, no wait, the lamp"), or remarks ("the pole is in the
way, get rid of it")."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from ..language.amounts import amount, direction, distance, number, percent
from ..language.colours import colour
from ..language.grammar import Reading, either, keyword, tokenise
from ..language.lexicon import FUNCTION_WORDS, PICTURE, word_set
from ..language.times import duration, moment, span
from ..language.verbs import IMPERATIVES
from .phrases import familiar, known_thing
from .qualities import made

_TAKEN_BACK = (
    r"(?:[,.;]|\s[-–—]+|\.\.+|…)?\s*\b(?:(?:er+|uh+|um+|oh|sorry|oops|ah),?\s*)*"
    r"(?:no wait|no,? no|wait,? no|hang on|hold on|wait|scratch that|strike that|i mean|i meant|i'm sorry|sorry|correction|"
    r"or rather|or better|make (?:that|it)|no,? make (?:that|it)|actually,?(?: make (?:it|that)| no)?|no)\b\s*"
    r"(?:[,:]|\.+|…)?\s*(?:(?:i mean|i meant|make (?:it|that)|no|rather|actually|it should be|better|sorry|wait|oops)\b,?\s*)*"
)
_AT_FIRST = re.compile(
    r"^\W*(?:(?:oh|ah|hmm|well|but),? )*(?:no,? no|no,? wait|wait,? no|hang on|hold on|(?:no|wait|sorry|oops)(?=[,.!:]))\b[,.!:\s]*"
    r"(?:(?:rather|better|actually|please)\b,? *)?(?P<last>\S.*)$",
    re.IGNORECASE,
)
"""What takes back the sentence before, for which another is said: "no wait, make it green"."""
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
    if anew := _AT_FIRST.match(sentence):
        yield anew["last"]
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


_FINITE = (
    r"(?:is|are|was|were|has|had|have|does|did|will|went|said|felt|got|came|made|isn't|aren't|wasn't|weren't|hasn't|haven't|"
    r"doesn't|didn't|won't|looks?|seems?|feels?|sits?|stands?|hangs?|lies?|keeps?|gets?|moves?|drives?|runs?|goes|walks?|hates?|"
    r"[a-z]{2,}ed|(?!this|less|always|plus|minus|across|unless)(?:[a-z]{3,}s|(?<=s )(?!into|onto|over|with|from|away|back|than|"
    r"then|and)[a-z]{3,}) (?:me|us|my|our|the|a|an|too|so|at|in|on|like|off|out|from|with|for))"
)
"""What makes a clause of words behind a noun: it states something."""
_CHANGES = r"(?:turns|becomes|changes|starts|stops|begins|grows|shrinks|fades|transforms|morphs)"
"""With which a clause may say what is wished for: "it turns into gold"."""
_LOOK = r"(?:looks?|feel|feeling|mood|vibes?|effect|style|aesthetic|atmosphere|impression|touch|drama|tone|quality|character)"
_AFTER_A_LOOK = (
    r"(?:i|we|they|he|she)(?:'m| am|'re| are)? (?:really |just |all )?(?:want|need|like|love|prefer|after|going for|aiming for|"
    rf"looking for|wants|likes|loves)(?: for)? (?:that|a|an|the|this|some|something)\b[^,.;]*?\b{_LOOK}(?: here| in it)?|"
    r"(?:i|we|they|he|she)(?:'ll| will| really| just| would|'d)*? (?:needs?|wants?|have|has|like|love) to (?:look|see|check|study|"
    r"watch|"
    r"focus|concentrate|read|find|compare|count|measure|send|use|submit|print|know|understand|think|inspect|examine|analy[sz]e|"
    r"present|"
    r"review|talk|hear)\b[^,.;\d]*|"
    r"(?:my|our|the|all|your|everyone's)(?: \w+)? (?:attention|focus|eyes?|emphasis|gaze|viewers?|audience|interest)\b[^,.;\d]*"
)
"""A wish that says what for: "I want that dreamy look", "I need to look at his knee"."""
_REMARK = (
    rf"(?:(?:in|on|at|for|with|as|when|since|because|to) (?:[\w'-]+ ){{1,4}}?)?(?:"
    rf"(?:(?:the|that|this|these|those|my|our|his|her|their|its|a|an|any|every|no|most|some|half) )?(?:[\w'-]+ ){{0,4}}?{_FINITE}"
    rf"\b.*?|(?:i|we|they|you|people|nobody|no one|everyone|everybody|someone|somebody)(?:'(?:m|re|ve|d|ll))? .*?|"
    rf"(?:it|that|this|he|she|there|which|who|what)(?:'s|'ll|'d| (?:[a-z]+ly )?(?!{_CHANGES}\b)(?:{_FINITE}|[a-z]+s))\b.*?|"
    rf"{_AFTER_A_LOOK})"
)
_REMARKED = (
    rf"(?i)^(?P<remark>{_REMARK}|[^,;:.!?]+(?=, (?:so|hence|therefore)\b))"
    r"(?:\s*(?:[,;:.!]+|\s-+|–|—|…)\s*(?:(?:so|and|then|hence|therefore|please)\b)?,?\s*|\s+so "
    r"(?:please )?|\s+(?=(?:please )?(?:make|turn|get|take|put|let|move|remove|delete|hide|lose|paint|blur|kill|bring|give|slow|"
    r"speed) "
    r"(?:it|him|her|them|that) ))(?P<command>[^\s].*)$"
)
"""What says how it is, and the command behind it."""
_IN_OTHER_WORDS = re.compile(
    r"^(?P<remark>.+?)(?:[,;(-]\s*|\s)(?:i\.? ?e\b\.?|that is to say|that is,|in other words|meaning|"
    r"namely),?:?\s+(?P<command>.+?)\)?$",
    re.IGNORECASE,
)
_IN_PICTURE = re.compile(rf"\b(?:in|of|on) (?:the|this) (?:{PICTURE})\b")
_WISH = re.compile(
    r"\b(?:should|must|shall|would|could|can(?! hardly| barely| not|not|['’]t)|(?<!nobody )(?<!no one )(?<!not )(?<!n't )(?:wants?|"
    r"wish|needs?(?! th[ai][ts]\b))|please|make|let|(?<!used )to be|has to|have to|except|but|only|(?:until|after|before) (?:(?:a|"
    r"the|that|this|about) )?(?:\w+ )?(?:second|end|start|half|middle|first|last)|seconds?|frames?)\b|\d|%",
    re.IGNORECASE,
)
"""What may be part of the command itself."""


_CONDITIONS = word_set("if when whenever unless until till while once should wherever where")


def _is_remark(text: str, headline: bool = False) -> bool:
    """Whether somebody says how something is, or which look is wanted, and gives no order but one that a `headline` tells."""
    first = text.split()[0].lower().strip(",")
    if first == "so":  # what it comes to: "so it's only her left"
        text = re.sub(r"\bonly\b", "", text)
    return bool(re.fullmatch(_AFTER_A_LOOK, text, re.IGNORECASE)) or not (
        _WISH.search(text) or first in _CONDITIONS or (first in IMPERATIVES - FUNCTION_WORDS and not headline)
    )


def remarked(sentence: str, known: Mapping[tuple[str, ...], str]) -> Iterator[str]:
    """The command behind a remark, with the thing of the remark in front: "the pole: get rid of it"."""
    match = _IN_OTHER_WORDS.match(sentence) or re.match(_REMARKED, sentence.strip())
    if match is None:
        return
    headline = sentence.strip()[match.end("remark") :].startswith(":")
    if match.re is not _IN_OTHER_WORDS and not _is_remark(match["remark"], headline):
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
    r"(\s*(?:[,;:.!?…()]+(?=\s|$)|\s[-–—]+(?=\s)|\s\(|\s(?=(?:so(?: that)?|because|since|as) (?:it|this|that|everything|they|he|"
    r"she|i|we|you|people|nobody|the|my|our)\b))\s*)"
)
_BESIDE = rf"(?i)(?:and |but |because |since |as |so (?:that )?|well,? )?(?:{_REMARK})"
"""What is said beside the command and tells how it is, or what it will look like."""


def without_remarks(sentence: str, known: Mapping[tuple[str, ...], str]) -> Iterator[str]:
    """The sentence without a headline ("evening mood: dim the lamp") and what is remarked behind the command."""
    first, *others = _BREAK.split(sentence)
    kept, left_out = [first], False
    for sign, part in zip(others[::2], others[1::2], strict=True):
        if sign.strip() == ":" and kept == [first] and not _means_something(first, known):
            kept, left_out = [part], True
        elif part and re.fullmatch(_BESIDE, part) and _is_remark(part) and _is_harmless(part, known):
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
