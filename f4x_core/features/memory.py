"""Running out of memory, told in one sentence. Torch-free."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..errors import F4xError

TORCH_WORDS = ("alloc", "memory", "overflow")
"""What torch's RuntimeErrors about memory say, whichever device and size they are about."""


@contextmanager
def memory_guard(what: str) -> Iterator[None]:
    """Turn running out of memory into one sentence: `what` is being computed at which size."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not any(word in str(error) for word in TORCH_WORDS):
            raise
        raise F4xError(f"{what} does not fit in memory; choose a smaller picture or grid.") from error
