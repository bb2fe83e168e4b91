"""The way to agree to a reading of a sentence or a question that is in doubt."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..language.refusal import Doubt


@contextmanager
def asking_for_yes() -> Iterator[None]:
    """Say with a `Doubt` how to agree."""
    try:
        yield
    except Doubt as doubt:
        raise Doubt(f"{doubt} Say '{doubt.instead}', or add --yes.", doubt.instead) from doubt
