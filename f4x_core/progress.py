"""Progress of long work; the terminal, JSON lines and Blender attach here."""

from typing import Protocol


class Progress(Protocol):
    """Called often during long work. Raising `errors.Cancelled` from it stops the work."""

    def __call__(self, stage: str, done: int, total: int, message: str = "") -> None:
        """Report that `done` of `total` steps of `stage` are finished; `message` is one short human line."""


def silent(stage: str, done: int, total: int, message: str = "") -> None:
    """Report nothing: the default progress."""
