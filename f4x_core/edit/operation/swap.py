"""Two things change places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from ...language.refusal import Refusal
from ..change import Change, Ease, Span, Vector, check_numbers, check_span
from ..description import span_words, steps_in_words, whom
from ..selects import Instance, Or, SelectKind, Text
from ..state import pivot_of
from ..values import Value
from ._place import vector
from .transform import Transform

if TYPE_CHECKING:
    from ..english import Sentences
    from ..phrases import SentenceContext, When, Who
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
        check_numbers("shift", self.shift or ())
        check_span(self.frames)

    UNCOVERS = True

    def steps(self) -> tuple[Change, ...]:
        if self.shift is None:
            raise F4xError("it is not measured yet how far they go; plan the edit, which settles that.")
        x, y, z = self.shift
        common: dict[str, Any] = {"frames": self.frames, "ease": self.ease}
        return Transform(self.select, (x, y, z), **common), Transform(self.other, (-x, -y, -z), **common)

    def settled(self, at: Settling) -> dict[str, Any]:
        """Return the shift (3,) from the base of the one to that of the other, and both with what is attached to them."""
        if self.shift is not None:
            return {}
        others = at.rows_of("other")
        if len(np.intersect1d(at.rows, others)):
            raise F4xError("The two things share Gaussians, so they cannot change places; name two separate things.")
        shift = vector(pivot_of("base", at.means[others]) - pivot_of("base", at.means[at.rows]))
        return {"shift": shift} | {name: at.with_attached(at.selects[name]) for name in ("select", "other")}

    def described(self) -> str:
        when = f" at frame {self.frames[0]:g}" if self.frames and self.ease == "step" else ""
        return f"swap {whom(self.select)} with {whom(self.other)}" + (when or span_words(self.frames, "to the end"))

    def as_seen(self, seen: Seen) -> str:
        way = steps_in_words(seen.in_widths(self.shift or (0.0, 0.0, 0.0)))
        return f"{self.described()}: {whom(self.select)} goes {way or 'nowhere'}, {whom(self.other)} the other way"

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        spots = say.literal("place|position|spot|location|places|positions|spots|locations")
        who = say.phrase(
            "((the) [<spots>] [of|between]|between|of) <who> ('s <spots>)", spots=spots, who=say.two_of_them | say.thing
        )
        swap = say.command(
            "swap the dog and the cat", swapped, "verb", say.NAMED, who, verb="{swap}|swap of",
            other=say.phrase("[with|for|and] <there_already> ('s (<spots>))", spots=spots),
            places=say.phrase("(the|their) <spots> (of|with)|with each other|with one another|around|over", spots=spots),
        )  # fmt: skip
        return say.Sentences((swap,))


def swapped(other: Who | None = None) -> Value:
    """Return an exchange of places with `other`, or of the two of a pair; Refusal where they are not two."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        pair: tuple[SelectKind, ...] = (who,) if other is None else (who, other(context))
        if other is not None and isinstance(who, Text):
            pair = (replace(who, number="any"), pair[1])
        elif isinstance(who, Text):
            pair = tuple(replace(who, labels=(label,)) for label in who.labels)
        elif other is None and isinstance(who, Or):
            pair = who.of
        if len(pair) == 1 and isinstance(who, Text) and who.number == "both":
            of = replace(who, number="any")
            pair = (Instance(of, "left", context.present), Instance(of, "right", context.present))
        if len(pair) != 2:
            raise Refusal("Two things can change places; say which two, for example 'swap the dog and the cat'.")
        return Swap(*pair, **when.growth)

    return value
