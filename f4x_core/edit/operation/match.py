"""The colors of something else in the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import colours
from ..change import Ease, Reply, Span, check_range, check_span
from ..description import strength_words, whom
from ..selects import SelectKind
from ..state import Appearance
from ._color import Dye


@dataclass(frozen=True)
class Match(Dye):
    """The colours of something else in the scene: mean and spread are carried over."""

    TAG = "match"
    select: SelectKind
    source: SelectKind
    """Whose colours."""
    strength: float = 1.0
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        """Validate."""
        check_range("strength", self.strength)
        check_span(self.frames)

    NEEDS_WHOM = True
    has_tones = True  # type: ignore[assignment]  # of both

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        """Means and spreads of both."""
        assert other is not None
        both = (whom, other)
        return tuple(colours.moments_of(colours.colours_of(one.sh), one.opacities) for one in both)

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The spread about the other mean."""
        return colours.matched(rgb, *tones), whom.sh[:, 1:], whom.opacities

    def described(self) -> str:
        """Match the dog to the cat."""
        return self.coming(f"match {whom(self.select)} {strength_words(self.strength)}to {whom(self.source)}")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """With another target."""

        def make(answer: Any, who: SelectKind, select: Any) -> Match:
            return cls(who, select(answer.source), frames=answer.span)

        return (Reply(("match",), "The colours of something else.", make, {"source": "target"}, "MatchColors"),)
