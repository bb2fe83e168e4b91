"""The colors of something else in the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...language.refusal import Refusal
from .. import colours
from ..change import Change, Ease, Reply, Span, check_range, check_span
from ..description import strength_words, whom
from ..selects import SelectKind
from ..state import Appearance
from ..values import Value
from ._color import Dye

if TYPE_CHECKING:
    from ..english import Sentences
    from ..phrases import SentenceContext, When, Who


@dataclass(frozen=True)
class Match(Dye):
    """The colours of something else in the scene: mean and spread are carried over."""

    TAG = "match"
    select: SelectKind
    source: SelectKind
    """The selection whose colours it takes."""
    strength: float = 1.0
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        check_range("strength", self.strength)
        check_span(self.frames)

    NEEDS_WHOM = True
    has_tones = True  # type: ignore[assignment]  # of both

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        assert other is not None
        both = (whom, other)
        return tuple(colours.moments_of(colours.colours_of(one.sh), one.opacities) for one in both)

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return colours.matched(rgb, *tones), whom.sh[:, 1:], whom.opacities

    def described(self) -> str:
        return self.coming(f"match {whom(self.select)} {strength_words(self.strength)}to {whom(self.source)}")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:

        def make(answer: Any, who: SelectKind, select: Any) -> Match:
            return cls(who, select(answer.source), frames=answer.span)

        return (Reply(("match",), "The colours of something else.", make, {"source": "target"}, "MatchColors"),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        source = (
            ~say.keyword("that of|those of|the colors of|the color of")
            + say.known_thing
            + ~say.keyword("'s (color|colors)")
        )
        source = say.unless(say.literal("a|an|some")) + source
        its = "[color scheme|color palette|color|colors|coloring|palette|look|appearance]"
        made = say.either(
            say.phrase(f"(a|an|the|some) {its} [of|from] <source>", source=source) >> matched,
            say.phrase("<known_thing> ['s|'] [color|colors|coloring|look|appearance]") >> matched,
            say.phrase(f"({say.SEEM}) [like|similar to|the same as] <source>", source=source) >> matched,
        )
        match = say.command(
            "match the dog to the cat", matched, "verb source", who=say.whose("color|colors|coloring|look") | say.thing,
            verb="{match}",
            source="[to|with|and|from] (the [color|colors|coloring|look] of|that of|those of) <known_thing> "
            "(['s|'] (color|colors|coloring))",
        )  # fmt: skip
        return say.Sentences(early=(match,), made=(made,))


def matched(source: Who) -> Value:
    """Return the match of a thing's colors to those of `source`."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        found = source(context)
        if found == who:
            raise Refusal("A thing cannot be matched to itself; say whose colors it is to have.")
        context.last = who  # what is spoken about is the thing that changes
        return Match(who, found, **when.coming)

    return value
