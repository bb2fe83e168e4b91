"""The result of a tool: JSON of bounded size, with texts from the scene file kept apart, and optionally an image."""

from __future__ import annotations

import io
import json
import unicodedata
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from ..errors import F4xError
from ..files import json_data

TEXTS = "from_scene"
"""The key of a result that holds all text from the scene file: names, labels, sentences of edits."""
MAX_RESULT_CHARACTERS = 40_000
"""Maximum length of a result as JSON: about ten thousand tokens."""
MAX_TEXT_CHARACTERS = 500
"""Maximum length of one text in a result."""
LIST_LIMITS = (500, 100, 20, 5)
"""Maximum numbers of entries of a list, tried in this order until the result is small enough."""


@dataclass(frozen=True)
class ToolResult:
    """Result of a tool call."""

    data: dict[str, Any]
    """JSON data that the tool computed."""
    texts: dict[str, Any] = field(default_factory=dict)
    """JSON data that was copied from the scene file."""
    png: bytes | None = None
    """An image."""

    def to_json(self) -> dict[str, Any]:
        """Return data and texts as one object, shortened to `MAX_RESULT_CHARACTERS`; F4xError if that is not possible."""
        whole = json_data({**self.data, **({TEXTS: self.texts} if self.texts else {})})
        for max_entries in LIST_LIMITS:
            shortened = _shortened(whole, max_entries)
            if len(json.dumps(shortened)) <= MAX_RESULT_CHARACTERS:
                return shortened
        raise F4xError(f"The answer is longer than {MAX_RESULT_CHARACTERS} characters; ask for less.")


def plain(text: str, max_characters: int = MAX_TEXT_CHARACTERS) -> str:
    """Return `text` as one line without control and formatting characters, which could hide or disguise parts of it."""
    head = text[: 4 * max_characters]  # a bounded amount of work, however long the text is
    shown = " ".join("".join(" " if unicodedata.category(c)[0] in "CZ" else c for c in head).split())
    return shown if len(shown) <= max_characters else shown[: max_characters - 1] + "…"


def encode_png(image: np.ndarray | Image.Image) -> bytes:
    """Return the bytes of a PNG file of uint8 `image (H,W,3)` or `(H,W)`."""
    file = io.BytesIO()
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(file, "PNG")
    return file.getvalue()


def _shortened(value: Any, max_entries: int) -> Any:
    """Return JSON data whose lists and objects keep at most `max_entries` entries and count the others."""
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, dict):
        kept = {plain(str(key)): _shortened(inner, max_entries) for key, inner in list(value.items())[:max_entries]}
        return kept if len(value) <= max_entries else {**kept, "left_out": len(value) - max_entries}
    if isinstance(value, list | tuple):
        return [_shortened(inner, max_entries) for inner in value[:max_entries]] + [
            f"{len(value) - max_entries} more"
        ] * (len(value) > max_entries)
    return value.item() if isinstance(value, np.generic) else value
