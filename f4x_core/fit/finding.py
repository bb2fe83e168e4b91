"""One sentence of the diagnosis: how much it weighs, what was measured, and what a person can do about it."""

from dataclasses import dataclass
from typing import Literal

MOVING_DEPTH = "The depth of what moves"
"""Begins every finding about it."""
Weight = Literal["problem", "note", "good"]


@dataclass(frozen=True)
class Finding:
    """One thing a person should know about their scene."""

    weight: Weight
    """`problem` costs quality, `note` is worth knowing, `good` is fine."""
    what: str
    """What was measured, one sentence."""
    advice: str = ""
    """What the person can do or supply; empty when there is nothing to do."""
