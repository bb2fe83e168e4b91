"""`f4x_core/edit/phrasings.txt` and `phrasings.npy`, from the sentences of `tests/data`; run as a script it writes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sentence_cases

from f4x_core.edit import language, meaning
from f4x_core.edit.request import Request
from f4x_core.errors import F4xError
from f4x_core.features.minilm import MiniLm
from f4x_core.fit.vocabulary import EVERYDAY

SMOOTHING = 0.3
"""Of the regression of vectors."""
UP = {"scale": ("smaller", "larger"), "speed": ("slower", "faster")}
"""Slots with an amount -> the operations of less and of more."""


@dataclass(frozen=True)
class Example:
    """A sentence that asks for an edit, as the last resort sees it."""

    row: dict[str, Any]
    request: Request
    operation: str
    phrasing: str
    slots: tuple[meaning.Slot, ...]
    labels: set[str]


def examples() -> list[Example]:
    """Those of both files that are edits."""
    rows = [*sentence_cases.rows(), *sentence_cases.rows(sentence_cases.OPENED)]
    return [example for row in rows if row["kind"] == "edit" and (example := _example(row))]


def _example(row: dict[str, Any]) -> Example | None:
    labels = sorted({*EVERYDAY, *sentence_cases._things(row)})
    known = language._known(labels)
    try:
        reading = language._words_of(language._plainly(row["text"], known)[0], known)
    except F4xError:
        return None
    request = Request(row["text"], labels, fps=24.0, frames=72, selected="selected" in row)
    nouns = {meaning.singular(words[-1]) for words in known}
    return Example(row, request, operation_of(row), *meaning.masked(reading), nouns)


def operation_of(row: dict[str, Any]) -> str:
    """The operation of a sentence; nothing where it has several, or is to be refused."""
    made = [name for slot in row["operations"] for name in _names(slot)]
    return made[0] if row["expect"] == "do" and len(made) == 1 else meaning.NOTHING


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
        return [UP["speed"][_is_more(slot["speed"])]] if "speed" in slot else [meaning.NOTHING]
    return [kind if kind in meaning._SENTENCES else meaning.NOTHING]


def _is_more(amount: float | str) -> bool:
    return amount == "up" or (amount != "down" and float(amount) > 1)


def vectors(texts: list[str]) -> np.ndarray:
    """(sentences, 384) unit vectors."""
    return MiniLm().encode(texts)


def kernel(features: np.ndarray) -> np.ndarray:
    """(sentences, sentences): the cosines of vectors, smoothed."""
    return features @ features.T + SMOOTHING * np.eye(len(features))


def write() -> None:
    """Write the table, and the regression of the vectors."""
    known = examples()
    found: dict[str, set[str]] = {}
    for example in known:
        found.setdefault(example.operation, set()).add(example.phrasing)
    lines = [line for name in sorted(found) for line in (f"# {name}", *sorted(found[name] - {""}))]
    meaning.PHRASINGS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    wanted = np.array([[example.operation == name for name in sorted(found)] for example in known], float)
    features = vectors([example.row["text"] for example in known])
    solved = features.T @ np.linalg.solve(kernel(features), wanted)
    np.save(meaning.VECTORS, solved.astype(np.float16), allow_pickle=False)


if __name__ == "__main__":
    write()
