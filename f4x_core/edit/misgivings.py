"""What makes a reading doubtful although every word of it is explained: its operations do not go together, or nothing in the
sentence speaks for one of them. Such a plan is only asked about; said in its own words it is sure (docs/language.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import combinations
from typing import Any

from ..features.phrasings import Meanings, highest_scores
from ..language.grammar import Reading, Refusal
from .description import describe, in_words, whom
from .meaning import MEANINGS, PHRASINGS, masked
from .operations import Name, Opacity, Operation, Recolour, Rekey, Transform
from .selects import All

SPOKEN_FOR = 0.2
"""Score from which a sentence, or a part of it, speaks for an operation: chosen on sentences as older grammars read them, by
tables without their author (docs/language.md)."""
_TONE = ("saturation up", "saturation down", "warmth up", "warmth down", "contrast up", "contrast down", "gray")
_PRESENCE = ("delete", "hide", "extract", "show", "transparent", "fade in", "fade out")
_LIGHT = ("brightness up", "brightness down", "glow")
_COLOR = ("recolour", "style", "match", "gray")
_ALIKE = (_TONE, _PRESENCE, _LIGHT, _COLOR, ("move", "swap"), ("duplicate", "follow"), ("faster", "slower", "freeze"))
"""Meanings of the table of phrasings of which words do not tell which is meant."""
_MEANING = {"grade": "gray", "opacity": "hide", "retime": "faster"}
"""Tag of an operation -> a meaning that speaks for it, where it is not called as the operation is."""
_PARTS = re.compile(r"\s*(?:[,.;:!?()]+(?=\s|$)|\s[-–—]+\s|\b(?:and then|and|but|then|while|plus)\b)\s*", re.IGNORECASE)
"""What stands between the parts of a sentence."""


def misgiving(sentence: str, operations: Sequence[Operation], words_of: Callable[[str], Reading]) -> str:
    """Why a plan of several operations may not be what the sentence means, for people; nothing where it may.

    `words_of`: the words of a text without what adds nothing to it; it may raise `Refusal`.
    """
    if len(operations) < 2 or sentence == in_words(operations):
        return ""
    for earlier, later in combinations(operations, 2):
        if why := _at_odds(earlier, later):
            return why
    phrasings: dict[str, str] = {}
    for part in (sentence, *_PARTS.split(sentence)):
        with suppress(Refusal):
            phrasings[part] = masked(words_of(part))[0]
    if phrasings.get(sentence) in Meanings.of(PHRASINGS).known:
        return ""
    scores = highest_scores(PHRASINGS, phrasings)
    for one in operations if scores else ():
        if (meanings := _meanings(one)) and max(scores.get(name, 0.0) for name in meanings) < SPOKEN_FOR:
            return f"I am not sure that '{describe(one)}' is asked for."
    return ""


def _meanings(operation: Operation) -> tuple[str, ...]:
    """The meanings that speak for an operation; none where no phrasing can."""
    if isinstance(operation, Recolour) and operation.mode == "multiply":
        return _LIGHT
    if isinstance(operation, Transform):
        size = ("larger", "smaller") if operation.scale != 1 else ()
        place = ("move", "swap") if any(operation.translate) else ()
        return size + place + (("rotate",) if any(operation.rotate) else ())
    name = _MEANING.get(operation.TAG, operation.TAG)
    return next((alike for alike in _ALIKE if name in alike), (name,) if name in MEANINGS else ())


def _at_odds(earlier: Operation, later: Operation) -> str:
    """Why an operation does not go with one before it; nothing where it does."""
    if isinstance(earlier, Name | Rekey) or isinstance(later, Name | Rekey):
        return ""
    if later.select == All() != earlier.select and _change(earlier) == _change(later):
        return f"'{describe(earlier)}' and '{describe(later)}' are the same."
    if earlier.select != later.select:
        return ""
    hidden = isinstance(earlier, Opacity) and not earlier.factor and earlier.frames is None
    if hidden and _meanings(later) != _PRESENCE:
        return f"Of {whom(earlier.select)} nothing would be seen."
    alike = _meanings(earlier) == _meanings(later) == _COLOR and getattr(later, "mode", "") != "add"
    if alike and getattr(earlier, "frames", None) == getattr(later, "frames", None):
        return f"'{describe(earlier)}' and '{describe(later)}' are about the same thing at the same time."
    return ""


def _change(operation: Operation) -> dict[str, Any]:
    """What is done, without for whom and when."""
    return {key: value for key, value in operation.to_json().items() if key not in ("select", "frames", "ease")}
