"""Commands that are nearest in meaning to a sentence that is refused, with the things, colors and amounts that it names.

Those are found by the grammar's own rules and give way to the name of their slot; what is left is compared with `phrasings.npz`
(`features/phrasings.py`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..features import phrasings
from ..features.phrasings import Slot, fill, ranked
from ..language.amounts import Amount, degree, fraction, multiple, number, percent
from ..language.colours import colour
from ..language.grammar import Mismatch, Reading, Rule, either, literal, table, unless
from ..language.lexicon import inflected, word_set
from ..language.times import duration, span
from ..language.verbs import VERBS
from .phrases import known_thing
from .qualities import any_look

PHRASINGS = Path(__file__).with_name("phrasings.npz")
"""Sentences that are known, without what stands in their slots, by operation."""
_PRONOUNS = word_set(
    "it that this them her him he she they you we i me us itself himself herself one ones these those there what which who "
    "my your our their its his"
)
_WAY = table(
    {
        "(to|toward|on) (the|its|his|her) left (side)|leftward": "to the left",
        "(to|toward|on) (the|its|his|her) right (side)|rightward": "to the right",
        "up|upward|higher": "up",
        "down|downward|lower": "down",
        "forward|[closer|nearer] (to [us|me|the camera])|toward [us|me|the camera|the viewer]": "closer",
        "back|backward|(further|farther) away (from [us|me|the camera])": "away",
        "clockwise": "clockwise",
        "counterclockwise": "counterclockwise",
    },
    reserve=False,
)


def _of_degree(*kinds: str) -> Rule:
    """A degree of one of the kinds."""

    def kind(how: Amount) -> str:
        if how.kind not in kinds:
            raise Mismatch
        return how.kind

    return degree >> kind


_SLOTS = {
    "TIME": either(span, unless(literal("a second")) + duration),  # "a second dog"
    "GRAY": literal("black and white|b and w|grayscale|monochrome|gray"),
    "WHO": known_thing,
    "LOOK": any_look,
    "COLOR": colour,
    "ANGLE": number + literal("degrees|degree|deg|grades"),
    "LENGTH": number + literal("widths|width|heights|height|lengths|length|meters|meter|m|units|unit"),
    "SHARE": fraction,
    "AMOUNT": multiple | percent,
    "SLIGHTLY": _of_degree("least", "small"),
    "MUCH": _of_degree("large", "most") | literal("really|very|strong"),
    "WAY": _WAY,
    "COUNT": number,
}
"""Slot -> its phrases; of two that are as long the first."""
_ABSOLUTE = {"", "="} | word_set("to at opacity alpha brightness exposure contrast saturation speed scale rate")
"""Words before an amount that is reached."""


def _quality(name: str, more: str) -> str:
    more += f" the {name} of WHO"
    return f"set the {name} of WHO to TO|{more} by AMOUNT|{more} SLIGHTLY|{more}"


MEANINGS = {
    "brightness up": "make WHO AMOUNT brighter|make WHO MUCH brighter|" + _quality("brightness", "increase"),
    "brightness down": "make WHO SHARE as bright|make WHO MUCH darker|" + _quality("brightness", "reduce"),
    "contrast up": _quality("contrast", "increase"),
    "contrast down": _quality("contrast", "reduce"),
    "saturation up": _quality("saturation", "increase"),
    "saturation down": _quality("saturation", "reduce"),
    "warmth up": "make WHO AMOUNT warmer|make WHO SLIGHTLY warmer|make WHO warmer",
    "warmth down": "make WHO AMOUNT cooler|make WHO SLIGHTLY cooler|make WHO cooler",
    "gray": "make WHO black and white",
    "recolour": "make WHO SLIGHTLY COLOR|make WHO COLOR",
    "style": "make WHO look like LOOK|make WHO LOOK",
    "match": "match WHO to OTHER",
    "blur": "blur WHO SLIGHTLY|blur WHO",
    "glow": "make WHO glow COLOR|make WHO glow SLIGHTLY|make WHO glow",
    "show": "show WHO again",
    "fade in": "fade in WHO",
    "fade out": "fade out WHO",
    "hide": "hide WHO",
    "transparent": "set the opacity of WHO to TO|make WHO AMOUNT transparent|make WHO SHARE transparent"
    "|make WHO SLIGHTLY transparent|make WHO transparent",
    "delete": "remove WHO",
    "extract": "keep only WHO",
    "larger": "scale WHO to TO|make WHO AMOUNT bigger|scale WHO by AMOUNT|scale WHO by COUNT|make WHO SHARE bigger"
    "|make WHO SLIGHTLY bigger|make WHO MUCH bigger|make WHO bigger",
    "smaller": "scale WHO to TO|make WHO SHARE as big|make WHO AMOUNT smaller|make WHO COUNT times smaller"
    "|make WHO SLIGHTLY smaller|make WHO MUCH smaller|make WHO smaller",
    "move": "move WHO WAY by LENGTH|move WHO WAY by SHARE of its width|move WHO WAY by COUNT widths|move WHO SLIGHTLY WAY"
    "|move WHO WAY",
    "rotate": "rotate WHO by ANGLE WAY|rotate WHO by ANGLE|rotate WHO by COUNT degrees WAY|rotate WHO by COUNT degrees"
    "|rotate WHO by TO degrees|turn WHO SLIGHTLY WAY|turn WHO WAY|turn WHO around",
    "swap": "swap WHO and OTHER|swap WHO",
    "duplicate": "copy WHO WAY TIME later|copy WHO TIME later|copy WHO WAY|copy WHO COUNT times|copy WHO AMOUNT|copy WHO",
    "follow": "let COUNT copies follow WHO TIME behind|let a copy follow WHO TIME behind|let a copy follow WHO",
    "faster": "play WHO at TO speed|play WHO AMOUNT as fast|play WHO AMOUNT faster|play WHO SLIGHTLY faster|play WHO faster",
    "slower": "play WHO at TO speed|play WHO at SHARE speed|play WHO AMOUNT slower|play WHO SLIGHTLY slower|play WHO slower",
    "freeze": "freeze WHO TIME|freeze WHO",
    "reverse": "play WHO in reverse",
    "loop": "loop WHO",
}
"""Meaning, by name, -> sentences for it, the first one whose slots are those that were said is taken; a time may always follow."""
_REMOVING = ("delete", "extract", "hide")
"""Operations that are not asked about where two things are named, be one unknown: "get the darkness off the dog". Examples have
them only where a verb of the sentence removes."""
_REMOVAL = literal("|".join(inflected(VERBS["delete"].replace(", ", "|"), 1)) + "|hide|isolate|keep only|show only")


def masked(reading: Reading) -> tuple[str, tuple[Slot, ...]]:
    """The words of a sentence with the names of its slots in place of what stands there, and the slots."""

    def ends_at(at: int) -> dict[str, int]:
        if reading.word(at) in _PRONOUNS and reading.word(at + 1).startswith("'"):
            return {}  # "it's" is a reason
        return {kind: max(found) for kind, rule in _SLOTS.items() if (found := rule.at(reading, at))}

    def slot(kind: str, at: int, end: int) -> Slot:
        if kind in ("AMOUNT", "SHARE", "COUNT") and reading.word(at - 1) in _ABSOLUTE:
            kind = "TO"
        elif kind == "SHARE" and reading.word(at - 1) == "by":
            kind = "AMOUNT"
        return Slot(kind, _WAY.at(reading, at)[end][0] if kind == "WAY" else reading.text_of(at, end))

    return phrasings.masked(reading.words[: len(reading.tokens)], ends_at, slot)


_FOR_EXAMPLE = {"COLOR": "red", "WAY": "to the left", "LOOK": "gold"}
_SOME_TIME = dict.fromkeys(("loop", "fade in"), " from second 1 to 2")
"""Operations that are for no time at all where none is said."""


def nearest(sentence: str, reading: Reading, there: Sequence[str]) -> Iterator[str]:
    """Examples of the operations that are nearest in meaning to a sentence, with what it says itself, about things that are `there`
    (any where that is not known)."""
    phrasing, slots = masked(reading)
    named = [f"{slot.words.lower()} " for slot in slots if slot.kind == "WHO"]
    labels = [f"the {label}" for label in there]
    said = [one for words in named for one in labels if one.lower()[3:] in f" {words}"] if there else named
    things = list(dict.fromkeys((*map(str.strip, said), *labels))) or ["it"]
    values = {slot.kind: slot.words for slot in reversed(slots) if slot.kind != "TIME"}
    values |= dict(zip(("WHO", "OTHER"), things, strict=False))
    if len(things) == 1:
        values.pop("OTHER", "")
    removes = bool(said) and any(_REMOVAL.at(reading, at) for at in range(len(reading.tokens)))
    for operation in ranked(PHRASINGS, sentence, phrasing):
        if operation in _REMOVING and not removes:
            continue
        templates = MEANINGS[operation].split("|")
        whole = [one for one in templates if {*re.findall("[A-Z]{2,}", one)} <= values.keys()]
        fullest = max(whole or templates[-1:], key=lambda one: len(re.findall("[A-Z]{2,}", one)))
        if example := fill(fullest, {**_FOR_EXAMPLE, **values}, (*_FOR_EXAMPLE, *values)):
            yield example + _SOME_TIME.get(operation, "")
