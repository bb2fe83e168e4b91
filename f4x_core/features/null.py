"""Null vectors of text encoders: the bias that all features of the `text` teacher have in common.

The classes of ImageNet are no fair sample of objects: a tenth are dogs, a sixteenth birds. A `text` feature is a weighted mean
of class names, so every feature is a little like "dog". With this bias removed, the scores of different words are comparable.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

FILES = {"minilm": Path(__file__).with_name("null_minilm.txt")}
"""By text encoder: the mean of the class embeddings (`offline.class_embeddings`), unit length, one number a line."""


@lru_cache
def null_vector(encoder: str) -> np.ndarray | None:
    """Return (C,) float32 of unit length for a text encoder; None where none was measured."""
    if encoder not in FILES:
        return None
    return np.array(FILES[encoder].read_text(encoding="ascii").split(), np.float32)
