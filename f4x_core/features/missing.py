"""Raises the error about features that a scene has not learnt; its family is F4X-FEATURES, whatever module asked."""

from typing import NoReturn

from ..errors import F4xError


def refuse(missing: str, options: str) -> NoReturn:
    """Raise F4xError: `missing` says what is not there, `options` of `f4x distill` add it."""
    raise F4xError(f"{missing}; `f4x distill SCENE {options}` adds what is missing.")
