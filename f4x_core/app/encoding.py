"""Text encoders, with a word about loading one: those of downloaded models take seconds."""

from __future__ import annotations

import numpy as np

from ..progress import Progress
from ..query.labels import Encode, encode_labels


def encoder(progress: Progress) -> Encode:
    """`encode_labels` that reports its first use: only words that the scene lacks need it."""
    loaded: set[str] = set()

    def encode(name: str, labels: list[str]) -> np.ndarray:
        if name not in loaded:
            loaded.add(name)
            progress(f"reading the text encoder for '{', '.join(labels)}'", 0, 1)
        return encode_labels(name, labels)

    return encode
