"""`f4x_core/edit/phrasings.npz`, fitted to the sentences of `tests/data`; run, it writes it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import sentence_cases

from f4x_core.edit import language, meaning
from f4x_core.errors import F4xError
from f4x_core.features.minilm import MiniLm
from f4x_core.features.phrasings import NOTHING, features, parts_of
from f4x_core.fit.vocabulary import EVERYDAY

SMOOTHING = 0.3
"""Of the regression of vectors."""
WORDS_SMOOTHING = 0.4
"""Of the regression of words: how little a single phrasing counts."""
UP = {"scale": ("smaller", "larger"), "speed": ("slower", "faster")}
"""Slots with an amount -> the operations of less and of more."""


@dataclass(frozen=True)
class Example:
    """A sentence that asks for an edit."""

    row: dict[str, Any]
    operation: str
    phrasing: str


def examples() -> list[Example]:
    """Those of both files that are edits."""
    rows = [*sentence_cases.rows(), *sentence_cases.rows(sentence_cases.OPENED)]
    return [example for row in rows if row["kind"] == "edit" and (example := _example(row))]


def _example(row: dict[str, Any]) -> Example | None:
    labels = sorted({*EVERYDAY, *sentence_cases._things(row)})
    known = language._known(tuple(labels))
    try:
        reading = language._words_of(language._plainly(row["text"], known)[0], known)
    except F4xError:
        return None
    return Example(row, operation_of(row), meaning.masked(reading)[0])


def operation_of(row: dict[str, Any]) -> str:
    """The operation of a sentence; nothing where it has several, or is to be refused."""
    made = [name for slot in row["operations"] for name in _names(slot)]
    return made[0] if row["expect"] == "do" and len(made) == 1 else NOTHING


def _names(slot: dict[str, Any]) -> list[str]:
    kind, amount = slot["operation"], slot.get("factor", slot.get("change", 0))
    if kind in ("brightness", "contrast", "warmth", "saturation"):
        return ["gray"] if kind == "saturation" and amount == 0 else [f"{kind} {'up' if _is_more(amount) else 'down'}"]
    if kind == "opacity":
        if amount == 1 or _is_more(amount):
            return ["show"]
        way = "fade in" if slot.get("inward") else "fade out" if slot.get("ease") else ""
        return [way or ("hide" if amount == 0 else "transparent")]
    if kind == "transform":
        named = {"translate": "move", "rotate": "rotate"}
        return [named.get(part) or UP[part][_is_more(slot[part])] for part in ("scale", *named) if part in slot]
    if kind == "retime":
        return [UP["speed"][_is_more(slot["speed"])]] if "speed" in slot else [NOTHING]
    return [kind if kind in meaning.MEANINGS else NOTHING]


def _is_more(amount: float | str) -> bool:
    return amount == "up" or (amount != "down" and float(amount) > 1)


class Words:
    """A regression from the words of phrasings to their meanings (kernel ridge, cosines of weighed words and pairs)."""

    def __init__(self, rows: list[tuple[str, str]]):
        """`rows`: (meaning, phrasing)."""
        self.names = sorted({name for name, _ in rows})
        counts = Counter(part for _, phrasing in rows for part in parts_of(phrasing))
        self.parts = sorted(part for part, count in counts.items() if count > 1)
        self.weights = np.log(len(rows) / np.array([counts[part] for part in self.parts]))
        column = {part: at for at, part in enumerate(self.parts)}
        self.features = features([phrasing for _, phrasing in rows], column, self.weights)
        self.wanted = np.array([[name == one for one in self.names] for name, _ in rows], float)
        self.kernel = self.features @ self.features.T + WORDS_SMOOTHING * np.eye(len(rows))


def vectors(texts: list[str]) -> np.ndarray:
    """(sentences, 384) unit vectors."""
    return MiniLm().encode(texts)


def kernel(features: np.ndarray) -> np.ndarray:
    """(sentences, sentences): the cosines of vectors, smoothed."""
    return features @ features.T + SMOOTHING * np.eye(len(features))


def without_itself(kernel: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(rows, meanings): the scores of each row by a regression that never saw it."""
    inverse = np.linalg.inv(kernel)
    return wanted - inverse @ wanted / np.diag(inverse)[:, None]


def fitted(known: list[tuple[str, str, str]]) -> dict[str, np.ndarray]:
    """What a table of phrasings holds, from (meaning, sentence, phrasing)."""
    words = Words(sorted({(name, phrasing) for name, _, phrasing in known if phrasing}))
    wanted = np.array([[one == name for name in words.names] for one, _, _ in known], float)
    whole = vectors([sentence for _, sentence, _ in known])
    return {
        "names": np.array(words.names),
        "parts": np.array(words.parts),
        "weights": words.weights.astype(np.float16),
        "words": (words.features.T @ np.linalg.solve(words.kernel, words.wanted)).astype(np.float16),
        "vectors": (whole.T @ np.linalg.solve(kernel(whole), wanted)).astype(np.float16),
    }


if __name__ == "__main__":
    known = [(one.operation, one.row["text"], one.phrasing) for one in examples()]
    np.savez_compressed(meaning.PHRASINGS, **fitted(known))
