"""Which words of a sentence may be left out when somebody agrees: the fewest, and none that changes what is done."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import product

from .colour_names import COLOURS, SHADES
from .grammar import VOCABULARY, Token
from .lexicon import FRACTIONS, FUNCTION_WORDS, ONES, TENS, singular, word_set

MAX_TRIES = 8
"""Ways to leave words out that are tried; each is a reading of the sentence."""
_MAX_BEFORE, _MAX_BEHIND, _MAX_WORDS = 4, 3, 9
_HARMLESS = word_set(
    "a an the this that these those my your our his her its their of in on at for with to as like so such kind sort and is are "
    "was were "
    "be being been am would could can will shall may might must should i you we me us he she they who which there here some any "
    "very "
    "really quite rather just even still already also too please well now ever maybe perhaps about around along together own do "
    "does using via "
    "did have has had want need get see let it"
)
"""Words that may go along with one that nobody knows."""
_MEANT = (VOCABULARY, FUNCTION_WORDS, COLOURS, SHADES, ONES, TENS, FRACTIONS)
"""Words that mean something here: negations, limits, amounts, times, directions, colours."""


def _keeps(token: Token, known: Collection[str], verbs: Collection[str]) -> bool:
    """Whether a word may not be left out."""
    forms = {token.text, singular(token.text)}
    if not token.is_word:
        return token.text not in (",", "-", '"', "'s", "'", "(", ")")
    if forms & set(known):
        return True
    return token.text not in _HARMLESS and (
        token.text in verbs or any(form in words for words in _MEANT for form in forms)
    )


def _of_what_stays(tokens: list[Token], start: int, stop: int, known: Collection[str]) -> bool:
    """Whether an "a" would go whose thing stays: "a party hat" is not the hat."""
    stays = stop < len(tokens) and bool({tokens[stop].text, singular(tokens[stop].text)} & set(known))
    return stays and any(token.text in ("a", "an", "some") for token in tokens[start:stop])


def leaving_out(tokens: list[Token], known: Collection[str], verbs: Collection[str]) -> Iterator[list[tuple[int, int]]]:
    """Spans [first, last) of tokens to leave out together, the fewest words first.

    `known`: words of what is there; `verbs`: those of commands. Each span holds a word that nobody knows.
    """
    choices: list[list[tuple[int, int] | None]] = []
    at = 0
    while at < len(tokens):
        end = at
        while end < len(tokens) and not _keeps(tokens[end], known, verbs):
            end += 1
        strange = [i for i in range(at, end) if tokens[i].is_word and tokens[i].text not in _HARMLESS]
        if strange:
            first, last = strange[0], strange[-1] + 1
            spans = [
                (start, stop)
                for start in range(max(at, first - _MAX_BEFORE), first + 1)
                for stop in range(last, min(end, last + _MAX_BEHIND) + 1)
                if stop - start <= _MAX_WORDS and not _of_what_stays(tokens, start, stop, known)
            ]
            choices.append([None, *spans])
        at = end + 1
    unknown = sum(token.is_word and not _keeps(token, known, verbs) and token.text not in _HARMLESS for token in tokens)
    if 2 * unknown > sum(token.is_word for token in tokens):
        return
    ways = [[span for span in way if span] for way in product(*choices[:3])] if choices else []
    ways = [way for way in ways if way]
    ways.sort(key=lambda way: sum(stop - start for start, stop in way))
    yield from ways[:MAX_TRIES]
