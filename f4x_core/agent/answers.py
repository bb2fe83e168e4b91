"""What a tool answers: JSON of bounded size, its texts marked as data, and perhaps a picture."""

from __future__ import annotations

import io
import json
import unicodedata
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from ..errors import F4xError
from ..files import finite

TEXTS = "from_scene"
"""The key of an answer under which everything lies that a scene file says: names, labels, what somebody once said."""
LARGEST_ANSWER = 40_000
"""Characters of JSON: about ten thousand tokens, more than a model wants to read."""
LONGEST_TEXT = 500
"""Characters of one text in it."""
LONGEST_LISTS = (500, 100, 20, 5)
"""Entries of every list in it; the first with which the answer is small enough."""


@dataclass(frozen=True)
class Reply:
    """The result of a tool."""

    data: dict[str, Any]
    """JSON of what was computed or done."""
    texts: dict[str, Any] = field(default_factory=dict)
    """JSON of what the scene file says."""
    png: bytes | None = None
    """A picture."""

    def to_json(self) -> dict[str, Any]:
        """Data and texts, cut to `LARGEST_ANSWER`; F4xError where even that does not help."""
        whole = finite({**self.data, **({TEXTS: self.texts} if self.texts else {})})
        for most in LONGEST_LISTS:
            told = _cut(whole, most)
            if len(json.dumps(told)) <= LARGEST_ANSWER:
                return told
        raise F4xError(f"The answer is longer than {LARGEST_ANSWER} characters; ask for less.")


def plain(text: str, longest: int = LONGEST_TEXT) -> str:
    """One line of `text` without control and formatting characters, which could hide or disguise something."""
    seen = text[: 4 * longest]  # enough, however much of it goes
    shown = " ".join("".join(" " if unicodedata.category(c)[0] in "CZ" else c for c in seen).split())
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def png_of(picture: np.ndarray | Image.Image) -> bytes:
    """A PNG file of uint8 `picture (H,W,3)` or `(H,W)`."""
    file = io.BytesIO()
    (picture if isinstance(picture, Image.Image) else Image.fromarray(picture)).save(file, "PNG")
    return file.getvalue()


def _cut(value: Any, most: int) -> Any:
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, dict):
        kept = {plain(str(key)): _cut(inner, most) for key, inner in list(value.items())[:most]}
        return kept if len(value) <= most else {**kept, "left_out": len(value) - most}
    if isinstance(value, list | tuple):
        return [_cut(inner, most) for inner in value[:most]] + [f"{len(value) - most} more"] * (len(value) > most)
    return value.item() if isinstance(value, np.generic) else value
