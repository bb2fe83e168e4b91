"""What a language model is asked."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """A sentence and what it may speak about; the rest of the arguments of `language.parse`."""

    sentence: str
    """What a person typed."""
    labels: Sequence[str] = ()
    """Words that the scene knows; empty = any."""
    names: Sequence[str] = ()
    """Selections with a name."""
    fps: float = 30.0
    """Clip frames per second."""
    frames: int = 1
    """Number of clip frames."""
    selected: bool = False
    """Whether something is selected at present."""
    frame: float = 0.0
    """Present clip frame."""
