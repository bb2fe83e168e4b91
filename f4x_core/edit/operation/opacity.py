"""More or less transparent: hidden, shown again, faded in and out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import F4xError
from ..change import SHOWN, Change, Ease, Looking, Reply, Span, check_range, check_span
from ..description import percent_words, span_words, whom
from ..selects import SelectKind
from ..state import Appearance

FADED_DEPTH = 16.0
"""Optical depth, the sum of -log(1 - alpha) along a pixel, of objects in fits of real clips: at this depth a fade is linear."""
MAX_ALPHA = 0.99
"""Maximum opacity that `thinned` reads: an opacity of 1 would never fade."""


@dataclass(frozen=True)
class Opacity(Change):
    """More or less transparent."""

    TAG = "opacity"
    select: SelectKind
    factor: float
    """Opacity is multiplied by it and held in [0, 1]; 0 hides."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """None: in full, from the first frame to the last alone. Else it comes between the two, as in `Transform`, and stays."""
    inward: bool = False
    """With `ease`: it is there from the start and goes between the two."""

    def __post_init__(self) -> None:
        """Validate."""
        check_range("factor", self.factor, 10)
        check_span(self.frames)
        if self.inward and self.ease is None:
            raise F4xError("inward needs an ease; give one, or leave inward out.")

    LOOKS = UNCOVERS = True

    def fraction(self, time: float, last: float) -> float:
        """It goes where it is `inward`."""
        fraction = super().fraction(time, last)
        return 1 - fraction if self.inward else fraction

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        """A fade is linear in alpha; nothing times a factor is nothing, so what was hidden comes back as it was."""
        old = state.opacities
        if self.factor < 1 and 0 < fraction < 1:  # on the way from all to the factor
            gone = np.float32(1 - self.factor)
            new = old * (1 - gone) + gone * thinned(old, 1 - fraction)
        else:
            new = np.clip(old * np.float32(1 + fraction * (self.factor - 1)), 0, 1)
        if self.factor > 1:
            new = np.where((old == 0) & ~scene.gone, np.float32(fraction) * scene.opacities, new)
        return state.with_opacities(chosen, new)

    @property
    def hides(self) -> bool:
        """Where nothing of it is seen."""
        return not self.factor

    @property
    def brings_back(self) -> bool:
        """Above 1."""
        return self.factor > 1

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Of "hide it for a second, then it is back" the first says all; "start invisible and fade in" is a fade."""
        if isinstance(later, Opacity) and later.select == self.select:
            if later == Opacity(self.select, SHOWN) and self.frames and self.frames[1]:
                return (self,)
            if later.frames and not self.frames:
                return (later,)
        return super().followed_by(later)

    def described(self) -> str:
        """Hide, show, fade."""
        who, factor = whom(self.select), self.factor
        if factor == SHOWN:
            sentence = f"show {who} again"
        elif factor > 1:
            sentence = f"increase the opacity of {who} by {percent_words(factor - 1)}"
        elif self.ease:
            away = f"fade {'in' if self.inward else 'out'} {who}"
            eased = "" if self.ease == "linear" else f" ({self.ease})"
            faded = f"fade {who} to {percent_words(factor)}" if factor else away
            return faded + span_words(self.frames, "to the end") + eased
        else:
            sentence = f"give {who} {percent_words(factor)} opacity" if factor else f"hide {who}"
        return sentence + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """In percent."""

        def make(answer: Any, who: SelectKind, _: Any) -> Opacity:
            return cls(who, answer.percent / 100, answer.span)

        doc = "Transparent: 0 hides, 100 is as before."
        return (Reply(("opacity",), doc, make, {"percent": range(101)}, "OpacityChange"),)


def thinned(opacities: np.ndarray, left: float) -> np.ndarray:
    """Opacities (n,) of which a picture shows the fraction `left` in [0, 1] of its alpha, where splats stand behind one another.

    `1 - (1 - o)^k` scales the optical depth D of a pixel by k; its alpha 1 - exp(-k D) is to be `left` (1 - exp(-D)). Scaling
    the opacities themselves would leave a stack of many nearly opaque half-way.
    """
    depth = -np.log1p(-left * -np.expm1(-FADED_DEPTH)) / FADED_DEPTH
    return (1 - (1 - np.minimum(opacities, MAX_ALPHA)) ** depth).astype(np.float32)
