"""The classes of ImageNet that the packaged teacher of words was shown, and what people call them. Needs no torch."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

from ..language.compounds import names_another
from ..language.lexicon import spellings

CLASS_NAMES = Path(__file__).with_name("imagenet_classes.txt")
"""The 1000 classes of ILSVRC 2012 in the order of the logits, one a line: the synonyms of the WordNet synset, then, after a
tab and where there is an everyday word for it, the kind of thing."""


class ImageClass(NamedTuple):
    """One class."""

    names: str
    """Synonyms, with commas between them."""
    kind: str
    """The everyday word for what it is; empty where there is none."""


@cache
def image_classes() -> tuple[ImageClass, ...]:
    """Return all classes, in the order of the logits."""
    lines = CLASS_NAMES.read_text(encoding="utf-8").splitlines()
    return tuple(ImageClass(names, kind) for names, _, kind in (line.partition("\t") for line in lines))


def kinds_of(name: str) -> frozenset[str]:
    """Return everyday words for what a name may mean: a swan, and a black swan, is a bird; empty where no class says so."""
    words = {*spellings(name)}
    return frozenset(found for word, found in _kinds() if word in words)


def is_of_a_kind(name: str) -> bool:
    """Return True if a name, or the last word of one, is an animal, a vehicle or another kind of thing that nobody is or wears."""
    words = {*spellings(name)} if names_another(name) else {*spellings(name), *spellings(name.split()[-1])}
    return any(one in words or kind in words for one, kind in _kinds())


@cache
def _kinds() -> frozenset[tuple[str, str]]:
    """Return (name or its last word, kind) of all classes."""
    found = set()
    for names, kind in image_classes():
        for name in names.lower().split(", ") if kind else ():
            found |= {(name, kind)} if names_another(name) else {(name, kind), (name.split()[-1], kind)}
    return frozenset(found)
