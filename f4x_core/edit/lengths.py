"""Lengths in a sentence, such as "10 cm" or "half a meter", in units of a scene that is known to be so many meters large."""

from __future__ import annotations

import re

METERS = {
    "m|met(?:er|re)s?": 1.0,
    "cm|centimet(?:er|re)s?": 0.01,
    "mm|millimet(?:er|re)s?": 0.001,
    "km|kilomet(?:er|re)s?": 1000.0,
    "ft|foot|feet": 0.3048,
    "in|inch|inches": 0.0254,
    "yd|yards?": 0.9144,
}
"""Names of a unit -> its length."""
WORDS = {"half an?": 0.5, "one|an?": 1.0, "two": 2.0, "three": 3.0, "four": 4.0, "five": 5.0, "ten": 10.0}
"""Numbers in front of lengths."""
_NUMBER = rf"(?P<digits>\d+(?:\.\d+)?|\.\d+)\s*|(?P<word>{'|'.join(WORDS)})\s+"
_COUNTED = r"(?<!\bthe )(?<!\bthese )(?<!\bboth )"
"""Words before a number of things and not before a length: "remove the two feet"."""
_LENGTH = re.compile(rf"\b{_COUNTED}(?:{_NUMBER})(?P<unit>{'|'.join(METERS)})\b(?!')", re.IGNORECASE)
_AMBIGUOUS = re.compile("in|foot|feet", re.IGNORECASE)
"""Units that are other words, too: they count behind digits alone."""


def in_units(sentence: str, meters: float) -> str:
    """Return `sentence` with its lengths in units of a scene, of which one is `meters` long."""

    def written(found: re.Match[str]) -> str:
        unit, digits, word = found["unit"].lower(), found["digits"], (found["word"] or "").lower()
        if not digits and _AMBIGUOUS.fullmatch(unit):
            return found[0]
        many = float(digits) if digits else _looked_up(WORDS, word)
        return f"{many * _looked_up(METERS, unit) / meters:.6f}".rstrip("0").rstrip(".") + " units"

    return _LENGTH.sub(written, sentence)


def _looked_up(table: dict[str, float], word: str) -> float:
    return next(value for pattern, value in table.items() if re.fullmatch(pattern, word))
