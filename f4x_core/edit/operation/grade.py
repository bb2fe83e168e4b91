"""Contrast, saturation, warmth and gamma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import F4xError
from ...geometry import spherical_harmonics
from .. import colours
from ..change import Ease, Span, check_range, check_span
from ..description import percent_words, whom
from ..selects import SelectKind
from ..state import Appearance
from ._color import ColorChange

MIN_GAMMA = 0.1
"""Minimum gamma, and the inverse of the maximum."""
WARMER = 0.5
"""Warmth of "warmer", the usual degree of it."""


@dataclass(frozen=True)
class Grade(ColorChange):
    """Contrast, saturation and warmth, in OKLab, and gamma; 1, 1, 0, 1 is as before."""

    TAG = "grade"
    select: SelectKind
    contrast: float = 1.0
    """Factor of the distance of each light from the mean light of the selection."""
    saturation: float = 1.0
    """Factor of the distance from gray."""
    warmth: float = 0.0
    """From -1, bluish, to 1, yellowish."""
    frames: Span | None = None
    ease: Ease | None = None
    gamma: float = 1.0
    """Each channel is raised to 1 / gamma after the rest: above 1 the midtones get brighter, black and white stay."""

    def __post_init__(self) -> None:
        """Validate."""
        check_range("contrast", self.contrast, 10)
        check_range("saturation", self.saturation, 10)
        if not MIN_GAMMA <= self.gamma <= 1 / MIN_GAMMA:
            raise F4xError(f"gamma is {self.gamma:g}; give a number from {MIN_GAMMA:g} to {1 / MIN_GAMMA:g}.")
        if not -1 <= self.warmth <= 1:
            raise F4xError(f"warmth is {self.warmth:g}; give a number from -1 to 1.")
        check_span(self.frames)

    FACTORS = ("contrast", "saturation")
    has_tones = of_picture = True  # type: ignore[assignment]  # whatever is graded

    def coloured(self, whom: Appearance, tones: Any) -> Appearance:
        """Contrast about the mean light `tones`, then gamma."""
        plain = (self.contrast, self.saturation, self.warmth) == (1, 1, 0)
        if plain and self.gamma == 1:
            return whom
        rgb = colours.colours_of(whom.sh)
        goal = rgb if plain else colours.graded(rgb, self.contrast, self.saturation, self.warmth, tones)
        if self.gamma != 1:
            goal = np.maximum(goal, 0) ** (1 / self.gamma)
        dc = spherical_harmonics.dc_from_rgb(goal).astype(np.float32)
        rest = whom.sh[:, 1:] * np.float32(self.contrast)
        return Appearance(whom.opacities, np.concatenate([dc[:, None], rest], axis=1))

    def described(self) -> str:
        """What differs from before."""
        who, parts = whom(self.select), []
        if self.contrast != 1:
            parts.append(f"set the contrast of {who} to {percent_words(self.contrast)}")
        if self.saturation != 1:
            parts.append(f"set the saturation of {who} to {percent_words(self.saturation)}")
        if self.gamma != 1:
            parts.append(f"set the gamma of {who} to {self.gamma:g}")
        if self.warmth or not parts:
            parts.append(f"make {who} {percent_words(abs(self.warmth))} {'cooler' if self.warmth < 0 else 'warmer'}")
        return self.coming(" and ".join(parts))
