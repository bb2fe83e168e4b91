"""Two things change places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from ..change import Change, Ease, Span, Vector, check_numbers, check_span
from ..description import span_words, steps_in_words, whom
from ..selects import SelectKind
from ..state import pivot_of
from ._place import vector
from .transform import Transform

if TYPE_CHECKING:
    from ..plan_lines import Seen
    from ..resolve import Settling


@dataclass(frozen=True)
class Swap(Change):
    """Two things change places: each goes where the base of the other is at the frame that is looked at, with its own motion."""

    TAG = "swap"
    select: SelectKind
    other: SelectKind
    """With whom."""
    shift: Vector | None = None
    """World units that `select` goes, and `other` the other way; None = planning measures it."""
    frames: Span | None = None
    """As in `Transform`."""
    ease: Ease = "smooth"
    """As in `Transform`."""

    def __post_init__(self) -> None:
        """Validate."""
        check_numbers("shift", self.shift or ())
        check_span(self.frames)

    UNCOVERS = True

    def steps(self) -> tuple[Change, ...]:
        """Two ways."""
        if self.shift is None:
            raise F4xError("it is not measured yet how far they go; plan the edit, which settles that.")
        x, y, z = self.shift
        common: dict[str, Any] = {"frames": self.frames, "ease": self.ease}
        return Transform(self.select, (x, y, z), **common), Transform(self.other, (-x, -y, -z), **common)

    def settled(self, at: Settling) -> dict[str, Any]:
        """From the base of the one to that of the other."""
        if self.shift is not None:
            return {}
        others = at.rows_of("other")
        if len(np.intersect1d(at.rows, others)):
            raise F4xError("The two things share Gaussians, so they cannot change places; name two separate things.")
        return {"shift": vector(pivot_of("base", at.means[others]) - pivot_of("base", at.means[at.rows]))}

    def described(self) -> str:
        """Swap the dog with the cat."""
        when = f" at frame {self.frames[0]:g}" if self.frames and self.ease == "step" else ""
        return f"swap {whom(self.select)} with {whom(self.other)}" + (when or span_words(self.frames, "to the end"))

    def as_seen(self, seen: Seen) -> str:
        """With the way."""
        way = steps_in_words(seen.in_widths(self.shift or (0.0, 0.0, 0.0)))
        return f"{self.described()}: {whom(self.select)} goes {way or 'nowhere'}, {whom(self.other)} the other way"
