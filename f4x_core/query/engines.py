"""What questions and edits use beside the scene: models, the rasteriser, and who hears of progress."""

from __future__ import annotations

from dataclasses import dataclass

from ..progress import Progress, silent
from .chat import ChatServer
from .labels import Encode


@dataclass(frozen=True, eq=False)
class Engines:
    """The models and the rasteriser that answer a question or read an edit."""

    server: ChatServer | None = None
    """Language model; None: nothing is sent, the program's own grammar reads and answers."""
    encode: Encode | None = None
    """Text encoder for words that the scene does not hold; None: those cannot be looked for."""
    backend: str = "auto"
    """The raster backend of the pictures that are looked at."""
    progress: Progress = silent
    """Is called `(stage, done, total, message)`."""


BARE = Engines()
"""No model, nobody who hears of progress."""
