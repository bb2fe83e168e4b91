"""Text encoders that report when they are loaded: those of downloaded models take seconds."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from ..progress import Progress
from ..query.labels import Encode, encode_labels


def encoder(progress: Progress) -> Encode | None:
    """Return `encode_labels` that reports its first use: only words that the scene lacks need it.

    None where torch is not installed, as in Blender's own Python: then only words that the scene knows are understood.
    """
    if find_spec("torch") is None:
        return None
    loaded: set[str] = set()

    def encode(name: str, labels: list[str]) -> np.ndarray:
        if name not in loaded:
            loaded.add(name)
            progress(f"reading the text encoder for '{', '.join(labels)}'", 0, 1)
        return encode_labels(name, labels)

    return encode
