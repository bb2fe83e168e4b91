"""Which known phrasing a sentence is like: a regression of its words, and of its vector where MiniLM's weights are installed.

A table of phrasings is an .npz file: `names (meanings,)`, `parts (n,)` of phrasings with their `weights (n,)`, `words (n,
meanings)` from the weighed parts of a phrasing, and `vectors (384, meanings)` from the unit vector of the whole sentence, to
about 1 for what is meant. `tests/core/sentence_phrasings.py` fits and writes it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import F4xError
from .text import TEXT_ENCODERS, TextEncoder

NOTHING = "nothing"
"""The meaning of what is none, or more than one."""
MIN_SCORE = 0.1
"""Below it a sentence is not like a meaning: of those that mean one 99 % have more, by a table that never saw them."""


@dataclass(frozen=True)
class Slot:
    """A phrase whose meaning is certain."""

    kind: str
    words: str


def masked(
    words: Sequence[str], ends_at: Callable[[int], Mapping[str, int]], slot: Callable[[str, int, int], Slot]
) -> tuple[str, tuple[Slot, ...]]:
    """The words of a sentence with the names of its slots in place of what stands there, and the slots.

    `ends_at`: kinds of slots that begin at a word -> where they end, of which the longest is taken; `slot`: one of a kind, from its
    first word to its end.
    """
    phrasing: list[str] = []
    slots: list[Slot] = []
    at = 0
    while at < len(words):
        ends = ends_at(at)
        kind = max(ends, key=ends.__getitem__, default="")
        end = ends.get(kind, at)
        if end > at:
            slots.append(slot(kind, at, end))
        phrasing.append(slots[-1].kind if end > at else words[at])
        at = max(end, at + 1)
    return " ".join(word for word in phrasing if word.replace("'", "").isalpha()), tuple(slots)


def ranked(table: Path, sentence: str, phrasing: str) -> list[str]:
    """The meanings in a table that a sentence is like at all, the likeliest first.

    `phrasing`: the sentence with the names of slots in place of what stands there.
    """
    scores = _scores(table, sentence, phrasing)
    found = sorted(zip(scores.tolist(), Meanings.of(table).names, strict=True), reverse=True)
    return [name for score, name in found if name != NOTHING and score >= MIN_SCORE]


def _scores(table: Path, sentence: str, phrasing: str) -> np.ndarray:
    """(meanings,) scores of a sentence by its words, and by its vector where MiniLM's weights are installed."""
    meanings, network = Meanings.of(table), _network()
    by_words = meanings.scores([phrasing])[0]
    return by_words if network is None else (by_words + (network.encode([sentence]) @ meanings.vectors)[0]) / 2


def fill(template: str, values: Mapping[str, str], spare: Collection[str]) -> str:
    """A sentence with the values of its slots; nothing where a slot has none, or a value that is not `spare` has no slot."""
    slots = set(_SLOT_NAME.findall(template))
    if not values.keys() - set(spare) <= slots <= values.keys():
        return ""
    return _SLOT_NAME.sub(lambda slot: values[slot[0]], template)


_SLOT_NAME = re.compile(r"\b[A-Z]{2,}\b")


@cache
def _network() -> TextEncoder | None:
    """What makes a vector of a sentence; None where its weights are not here or not readable."""
    entry = TEXT_ENCODERS["minilm"]
    with suppress(F4xError):
        return entry.load() if entry.here else None
    return None


@dataclass(frozen=True)
class Meanings:
    """A table of phrasings: what its words and its vector tell about a sentence."""

    names: list[str]
    """Meanings."""
    column: dict[str, int]
    """Part of a phrasing -> its column among the features."""
    weights: np.ndarray
    """(parts,): how telling each is."""
    words: np.ndarray
    """(parts, meanings): the regression of the words."""
    vectors: np.ndarray
    """(384, meanings): the regression of the vectors."""

    @classmethod
    @cache
    def of(cls, table: Path) -> Meanings:
        """Those of a file."""
        with np.load(table, allow_pickle=False) as file:
            column = {part: at for at, part in enumerate(file["parts"].tolist())}
            weights, words, vectors = (file[name].astype(np.float32) for name in ("weights", "words", "vectors"))
            return cls(file["names"].tolist(), column, weights, words, vectors)

    def scores(self, phrasings: Sequence[str]) -> np.ndarray:
        """(phrasings, meanings) by their words: about 1 for what is meant."""
        return features(phrasings, self.column, self.weights) @ self.words


def features(phrasings: Sequence[str], column: Mapping[str, int], weights: np.ndarray) -> np.ndarray:
    """(phrasings, parts): unit vectors of the weighed parts that each has."""
    rows = np.zeros((len(phrasings), len(column)))
    for row, phrasing in zip(rows, phrasings, strict=True):
        row[[column[part] for part in parts_of(phrasing) if part in column]] = 1
    rows *= weights
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


def parts_of(phrasing: str) -> set[str]:
    """Words, their stems and pairs of words."""
    words = phrasing.split()
    return {
        *words,
        *(f"{_ENDING.sub('', word)}-" for word in words),
        *map(" ".join, pairwise(words)),
    }


_ENDING = re.compile(r"(?<=[a-z]{3})(?:ing|ed|es|er|s|e)$")
