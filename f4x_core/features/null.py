"""What a teacher of words says when it sees nothing: the vector that every one of its features leans to.

The classes of ImageNet are no fair sample of things: a tenth are dogs, a sixteenth birds. A `text` feature is a mean of
class names, so that any cell is a little like "dog"; taken off, "dog" on a lawn and "camel" on a camel can be compared.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

FILES = {"minilm": Path(__file__).with_name("null_minilm.txt")}
"""By text encoder: the mean of the class embeddings (`offline.class_embeddings`), unit length, one number a line."""


@lru_cache
def null_vector(encoder: str) -> np.ndarray | None:
    """(C,) float32 of unit length for a text encoder; None where none was measured."""
    if encoder not in FILES:
        return None
    return np.array(FILES[encoder].read_text(encoding="ascii").split(), np.float32)
