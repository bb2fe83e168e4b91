"""Turns running out of memory into one clear error message. Torch-free."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..errors import F4xError

TORCH_WORDS = ("alloc", "memory", "overflow")
"""Words in the messages of torch's RuntimeErrors about memory, on any device."""


@contextmanager
def memory_guard(what: str) -> Iterator[None]:
    """Raise F4xError where the block runs out of memory; `what` names the computation and its size in the message."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not any(word in str(error) for word in TORCH_WORDS):
            raise
        raise F4xError(f"{what} does not fit in memory; choose a smaller picture or grid.") from error
