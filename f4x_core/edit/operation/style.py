"""A look from a table, such as a material or a mood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import F4xError
from .. import colours
from ..change import Ease, Reply, Span, check_range, check_span
from ..description import strength_words, whom
from ..records import near
from ..selects import SelectKind
from ..state import Appearance
from ..styles import STYLES
from ._color import Dye

PICTURE_LOOKS = ("night", "sunset", "sepia", "autumn", "neon")
"""Looks of a whole picture."""


@dataclass(frozen=True)
class Style(Dye):
    """A look from a table: light and dark become a ramp of colours."""

    TAG = "style"
    select: SelectKind
    look: str
    """Name of an entry of `styles.STYLES`."""
    strength: float = 1.0
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        """Validate."""
        if self.look not in STYLES:
            raise F4xError(f"there is no look {self.look!r}{near(self.look, STYLES)}; known: {', '.join(STYLES)}.")
        check_range("strength", self.strength)
        check_span(self.frames)

    has_tones = is_covered = True  # type: ignore[assignment]  # for every look

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        """Between which lights the visible Gaussians lie."""
        rgb, visible = colours.colours_of(whom.sh), whom.opacities > 0
        return colours.lights_of(rgb[visible] if visible.any() else rgb)

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The ramp; some looks are translucent."""
        look = STYLES[self.look]
        opacities = whom.opacities * np.float32(1 + self.strength * (look.opacity - 1))
        return colours.styled(rgb, look, *tones), self.faded(whom), opacities

    @property
    def of_picture(self) -> bool:
        """Night, sunset."""
        return self.look in PICTURE_LOOKS

    def described(self) -> str:
        """Look like gold."""
        return self.coming(f"make {whom(self.select)} look {strength_words(self.strength)}like {self.look}")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Its name and strength."""

        def make(answer: Any, who: SelectKind, _: Any) -> Style:
            return cls(who, answer.look, answer.strength / 100, answer.span)

        fields = {"look": tuple(STYLES), "strength": range(101)}
        return (Reply(("style",), "A look from the table.", make, fields, "Look"),)
