"""A sentence with what it may speak about."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """The input of the grammar or of a language model."""

    sentence: str
    """The sentence as a person typed it."""
    labels: Sequence[str] = ()
    """Words that the scene knows; empty = any."""
    names: Sequence[str] = ()
    """Selections with a name."""
    fps: float = 30.0
    """Clip frames per second."""
    frames: int = 1
    """Number of clip frames."""
    selected: bool = False
    """True where something is selected at present."""
    frame: float = 0.0
    """Present clip frame."""
