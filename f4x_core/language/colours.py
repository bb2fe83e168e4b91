"""Which colour: names and shades, "reddish", "redder"."""

from __future__ import annotations

from collections.abc import Iterator

from .colour_names import COLOURS, HALF, SHADES, Colour, from_hex, shaded
from .grammar import Reading, either, generated, keyword, table
from .lexicon import word_set

_MAX_COLOUR_WORDS = 3
"""Words that a colour's name is written in: "light sky blue"."""
_COMPARED = {"darker": "dark", "lighter": "light", "brighter": "bright", "paler": "pale", "deeper": "deep"}
"""Shades as they are compared: "a darker blue", "a lighter shade of green"."""


def _colour_at(reading: Reading, at: int) -> Iterator[tuple[int, Colour]]:
    word = reading.word(at)
    if word.startswith("#") and len(word) > 1:
        yield at + 1, from_hex(word[1:])
    for count in range(_MAX_COLOUR_WORDS, 0, -1):
        name = "".join(reading.word(i) for i in range(at, at + count))
        if name in COLOURS and at + count <= len(reading.tokens):
            yield at + count, COLOURS[name]
    of_it = at + 1 + 2 * (reading.word(at + 1) in ("shade", "tone") and reading.word(at + 2) == "of")
    shade = _COMPARED.get(word, word) if of_it > at + 1 or (at and reading.word(at - 1) == "a") else word
    if shade in SHADES:
        for end, (base,) in colour.at(reading, of_it).items():
            yield end, shaded(shade, base)


def _mixed_at(reading: Reading, at: int) -> Iterator[tuple[int, Colour]]:
    """Yield (end, color) of two colors in one word, "blue-green", of one with a tinge, "reddish brown", and of a plain one."""
    for end, (tinge,) in colourish.at(reading, at).items():
        for last, base in _colour_at(reading, end):
            yield last, _between(base, tinge, _TINGE)
    for end, one in _colour_at(reading, at):
        if reading.word(end) in PURE_COLOURS and reading.word(end - 1) not in PURE_COLOURS:  # "eggshell white"
            yield end + 1, one
        if reading.sentence[reading.tokens[end - 1].end :][:1] == "-":
            for last, other in _colour_at(reading, end):
                yield last, _between(one, other, HALF)
    yield from _colour_at(reading, at)


def _between(one: Colour, other: Colour, share: float) -> Colour:
    red, green, blue = (round(a + share * (b - a), 3) for a, b in zip(one, other, strict=True))
    return red, green, blue


_TINGE = 0.25
"""How far "reddish brown" is from brown to red."""
_REDDER = {name + "er": name for name in ("green", "yellow", "pink", "brown", "black", "gray")}
_REDDER |= {"redder": "red", "bluer": "blue", "whiter": "white", "purpler": "purple", "oranger": "orange"}
_REDDISH = {name + "ish": name for name in ("green", "yellow", "pink", "brown", "gray", "black", "orange")}
_REDDISH |= {"reddish": "red", "bluish|blueish": "blue", "whitish": "white", "purplish": "purple", "goldish": "gold"}


def _first_words() -> frozenset[str]:
    """Return the words that a color may begin with."""
    return frozenset(name[:end] for name in COLOURS for end in range(1, len(name) + 1)).union(SHADES, _COMPARED, "#")


colourish = table({word: COLOURS[name] for word, name in _REDDISH.items()}) | generated(
    lambda reading, at: ((end + 1, rgb) for end, rgb in _colour_at(reading, at) if reading.word(end) == "ish"),
    _first_words,
)
colour = generated(_mixed_at, lambda: _first_words().union(colourish.first or ()))
more_colour = either(
    table({word: COLOURS[name] for word, name in _REDDER.items()}) >> (lambda rgb: (rgb, 1)),
    keyword("more") + (colour | colourish) >> (lambda rgb: (rgb, 1)),
    keyword("less") + (colour | colourish) >> (lambda rgb: (rgb, -1)),
)
PURE_COLOURS = word_set(
    "red green blue yellow black white gray brown purple pink cyan magenta turquoise beige crimson maroon navy teal violet "
    "golden scarlet burgundy khaki indigo fuchsia"
)
"""Colour words that are no things: "delete the rose" has an object, "delete the red" has none."""
