"""Words for what things cast on the background: shadows, reflections, ripples."""

from __future__ import annotations

import re

_WORDS = re.compile(
    r"(?:(?:the|its|his|her|their) )?(?:(?P<whose>.+)'s? )?(?:shadow|reflection|ripple)s?", re.IGNORECASE
)


def is_cast(label: str) -> bool:
    """Return True if `label` names what is cast: "shadow", "the dog's shadow", "reflections"."""
    return _WORDS.fullmatch(" ".join(label.split())) is not None


def caster(label: str) -> str | None:
    """Return the caster in `label`: "dog" of "the dog's shadow"; None where the word names none."""
    found = _WORDS.fullmatch(" ".join(label.split()))
    return found and found["whose"]
