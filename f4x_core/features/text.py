"""Text encoders: labels become vectors in the space of a teacher's features."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from ..errors import F4xError
from .weights import local_path


class TextEncoder(Protocol):
    """Turns labels into unit vectors."""

    dim: int
    """Length of the vectors."""
    temperature: float
    """Label probabilities are softmax(cosine / temperature)."""

    def encode(self, labels: list[str]) -> np.ndarray:
        """Return (L, dim) float32 unit vectors of `labels`."""
        ...


@dataclass(frozen=True)
class TextEncoderEntry:
    """Name, weights and loader of one text encoder."""

    name: str
    """Name in `FeatureSpec.text_encoder`."""
    weights: str
    """Their name in `weights.WEIGHTS`."""
    factory: str
    """`module:class` below this room, called with `model` (path of the weights, hub id or None) and `options`."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the factory."""

    @property
    def here(self) -> bool:
        """Return True if its weights are on this machine."""
        return local_path(self.weights) is not None

    def load(self, path: Path | str | None = None) -> TextEncoder:
        """Return the encoder, its packages imported now; F4xError when they or the weights are absent."""
        return cast(TextEncoder, factory_of(self.factory)(model=path, **self.options))


TEXT_ENCODERS = {
    entry.name: entry
    for entry in (
        TextEncoderEntry("minilm", "minilm", ".minilm:MiniLm"),
        TextEncoderEntry("clip", "clip", ".models.textimage:TextImageEncoder", {"name": "clip"}),
        # LSeg was trained with bare labels.
        TextEncoderEntry(
            "clip-b32", "clip-b32", ".models.textimage:TextImageEncoder", {"name": "clip-b32", "templates": ("{}",)}
        ),
        TextEncoderEntry("tipsv2", "tipsv2", ".models.textimage:TextImageEncoder", {"name": "tipsv2"}),
    )
}
"""Every text encoder by the name that specs use."""


def find_text_encoder(name: str | None) -> TextEncoderEntry:
    """Return the entry called `name`; F4xError lists the known ones."""
    if name not in TEXT_ENCODERS:
        raise F4xError(f"There is no text encoder '{name}' here; known: {', '.join(TEXT_ENCODERS)}.")
    return TEXT_ENCODERS[name]


def load_text_encoder(name: str | None, path: Path | str | None = None) -> TextEncoder:
    """Return the text encoder called `name`; F4xError when there is none or it is not installed."""
    return find_text_encoder(name).load(path)


def factory_of(reference: str) -> Callable[..., object]:
    """Return the class that a registry names as `.module:class`, its module imported now."""
    module, _, name = reference.partition(":")
    return getattr(import_module(module, __package__), name)


def average_templates(
    labels: list[str], templates: Sequence[str], embed: Callable[[list[str]], np.ndarray]
) -> np.ndarray:
    """Return (L, dim) float32 unit vectors: each label in every template ("a photo of a {}."), embedded, mean of unit vectors.

    F4xError for an empty list or an empty label.
    """
    labels = [label.strip() for label in labels]
    if not labels or not all(labels):
        raise F4xError("An empty label has no meaning; give at least one word.")
    vectors = np.asarray(embed([template.format(label) for label in labels for template in templates]), np.float32)
    return unit(unit(vectors).reshape(len(labels), len(templates), -1).mean(1))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return the vectors (..., C) scaled to length 1; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
