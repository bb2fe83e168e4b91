"""Which known phrasing a sentence is like: a regression of its words, and of its vector where MiniLM's weights are installed.

A table of phrasings is a text file, `# meaning` and below it a line each. Beside it lies a file of the same name and `.npy`:
float16 (384, meanings), from the unit vector of a whole sentence to about 1 for its meaning, fitted by
`tests/core/sentence_phrasings.py`.
"""

from __future__ import annotations

import re
from collections import Counter
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
CERTAIN, AHEAD = 0.3, 0.1
"""Score from which a meaning is asked about, and by how much it has to lead; right ones are at 1."""
AHEAD_BY_BOTH = 0.06
"""The lead by words and vector together, which count the same: chosen on sentences that older grammars refused, the author's own
left out (docs/language.md)."""
LIKE_THE_FIRST = 0.25
"""Of the highest score: below it a meaning is like a sentence by the words that it shares with most of them."""
_SMOOTHING = 0.4
"""Of the regression: how little a single phrasing counts."""


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


def likeliest(table: Path, sentence: str, phrasing: str) -> str:
    """The meaning in a table that a sentence is like, `NOTHING` where that is not certain; `phrasing`: the sentence with the
    names of slots in place of what stands there."""
    scores, ahead = _scores(table, sentence, phrasing)
    return leading(scores, Meanings.of(table).names, ahead)


def ranked(table: Path, sentence: str, phrasing: str) -> list[str]:
    """The meanings in a table that a sentence is like at all, the likeliest first; the arguments are those of `likeliest`."""
    scores, _ = _scores(table, sentence, phrasing)
    found = sorted(zip(scores.tolist(), Meanings.of(table).names, strict=True), reverse=True)
    found = [(score, name) for score, name in found if name != NOTHING]
    return [name for score, name in found if score > found[0][0] * LIKE_THE_FIRST]


def _scores(table: Path, sentence: str, phrasing: str) -> tuple[np.ndarray, float]:
    """(meanings,) scores of a sentence, and by how much the first of them has to lead."""
    by_both = _by_both(table, {sentence: phrasing})
    return (Meanings.of(table).scores([phrasing])[0], AHEAD) if by_both is None else (by_both[0], AHEAD_BY_BOTH)


def highest_scores(table: Path, phrasings: Mapping[str, str]) -> dict[str, float]:
    """Meaning of a table -> the highest score that any of the sentences -> `phrasings` has for it, by words and vector together;
    empty where MiniLM's weights are not installed: words alone miss too much."""
    scores = _by_both(table, phrasings)
    return {} if scores is None else dict(zip(Meanings.of(table).names, scores.max(axis=0).tolist(), strict=True))


def _by_both(table: Path, phrasings: Mapping[str, str]) -> np.ndarray | None:
    """(sentences, meanings) scores by words and vector together; None where MiniLM's weights are not installed."""
    if (network := _network()) is None:
        return None
    return (Meanings.of(table).scores([*phrasings.values()]) + network.encode([*phrasings]) @ of_vectors(table)) / 2


def leading(scores: np.ndarray, names: Sequence[str], ahead: float) -> str:
    """The name with the highest of `scores (meanings,)`, `NOTHING` where it is low or leads by less than `ahead`."""
    first, second = np.argsort(-scores)[:2]
    certain = scores[first] >= CERTAIN and scores[first] - scores[second] >= ahead
    return names[first] if certain else NOTHING


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


@cache
def of_vectors(table: Path) -> np.ndarray:
    """(384, meanings) float32: the regression of the vectors."""
    return np.load(table.with_suffix(".npy"), allow_pickle=False).astype(np.float32)


class Meanings:
    """A regression from the words of phrasings to their meanings (kernel ridge, cosines of weighed words and pairs)."""

    def __init__(self, rows: Sequence[tuple[str, str]]):
        """`rows`: (meaning, phrasing)."""
        self.names = sorted({name for name, _ in rows})
        counts = Counter(part for _, phrasing in rows for part in _parts(phrasing))
        kept = sorted(part for part, count in counts.items() if count > 1)
        self.column = {part: at for at, part in enumerate(kept)}
        self.weight = np.log(len(rows) / np.array([counts[part] for part in kept]))
        self.features = self._features([phrasing for _, phrasing in rows])
        self.wanted = np.array([[name == one for one in self.names] for name, _ in rows], float)
        self.kernel = self.features @ self.features.T + _SMOOTHING * np.eye(len(rows))
        self.solved = self.features.T @ np.linalg.solve(self.kernel, self.wanted)

    @classmethod
    @cache
    def of(cls, table: Path) -> Meanings:
        """Those of a table."""
        return cls(read_phrasings(table))

    def scores(self, phrasings: Sequence[str]) -> np.ndarray:
        """(phrasings, meanings): about 1 for what is meant."""
        return self._features(phrasings) @ self.solved

    def _features(self, phrasings: Sequence[str]) -> np.ndarray:
        rows = np.zeros((len(phrasings), len(self.column)))
        for row, phrasing in zip(rows, phrasings, strict=True):
            row[[self.column[part] for part in _parts(phrasing) if part in self.column]] = 1
        rows *= self.weight
        return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


@cache
def known_phrasings(table: Path) -> frozenset[str]:
    """Those of a table, without their meanings."""
    return frozenset(phrasing for _, phrasing in read_phrasings(table))


def read_phrasings(table: Path) -> list[tuple[str, str]]:
    """(meaning, phrasing) of each line of a table."""
    rows: list[tuple[str, str]] = []
    name = ""
    for line in table.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            name = line[2:]
        else:
            rows.append((name, line))
    return rows


def _parts(phrasing: str) -> set[str]:
    """Words, their stems and pairs of words."""
    words = phrasing.split()
    return {
        *words,
        *(f"{_ENDING.sub('', word)}-" for word in words),
        *map(" ".join, pairwise(words)),
    }


_ENDING = re.compile(r"(?<=[a-z]{3})(?:ing|ed|es|er|s|e)$")
