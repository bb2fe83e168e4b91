"""Take something out, or leave nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...language.refusal import Refusal
from ..change import Change, ChangeWithShadow, Reply, Span, check_span
from ..description import span_words, whom, whom_with
from ..selects import All, Not, SelectKind
from ..state import Appearance

if TYPE_CHECKING:
    from ..apply import Looking
    from ..english import Sentences
    from ..phrases import SentenceContext, When
    from ..splat_rows import SplatRows


class Removal(Change):
    """Base: what is chosen is not there; deleted rows stay with opacity 0."""

    LOOKS = UNCOVERS = NEEDS_WHOM = True
    frames: Span | None

    def __post_init__(self) -> None:
        check_span(self.frames)

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        return rows if self.frames is not None else replace(rows, gone=rows.gone | chosen)

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        return state.with_opacities(chosen, np.float32(0))

    @property
    def removes(self) -> bool:
        return True


@dataclass(frozen=True)
class Delete(Removal, ChangeWithShadow):
    """Take it out."""

    TAG = "delete"
    select: SelectKind
    frames: Span | None = None
    """Gone from … to; None = always."""

    ANSWERS = -1

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Join two removals into one; Refusal where nothing would be left."""
        if later.removes and later.select == self.select:
            return (self,)
        if later.removes and later.select == Not(self.select):
            raise Refusal("Nothing would be left; say for example 'keep only the dog' if the rest is to go.")
        return super().followed_by(later)

    def described(self) -> str:
        return f"remove {whom_with(self)}" + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:

        def make(answer: Any, who: SelectKind, _: Any) -> Removal:
            return Delete(who, answer.span) if answer.op == "delete" else Extract(who, answer.span)

        return (Reply(("delete", "keep_only"), "Delete it, or leave nothing else.", make, {}, "RemovalChange"),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        all_but = say.command(
            "remove everything except the dog", say.always(extracted), "verb", say.NAMED, say.everything_but,
            verb="[{!delete}|clear|drop|cut|strip|wipe|scrub] (<OUT>)",
        )  # fmt: skip
        without = say.command(
            "without the dog", say.always(deleted), "without", say.NAMED,
            without=say.keyword(
                "(the|this) (same) [scene|picture|video|clip|image|shot] ([would be|is|looks|would look] (so|"
                "much|a lot|way) [better|nicer|best|good|cleaner]) (but) without|without|minus|no more|[i|we] "
                "no longer [want|need] (to see)|there should be no|there must be no|let there be no|[i|we] "
                "can do without|[i|we] (really) do not [want|need|like] (to [see|have])"
            )
            | say.literal("no") + say.unless(say.literal(",|.|the|that|this|it|wait|not|need"))
            | say.literal("should not be (in) [here|there|the [picture|shot|scene|frame|video|clip]]|is no longer there"),
        )  # fmt: skip
        take_out = say.command(
            "take the car out", say.always(deleted), "verb out", say.NAMED, verb="{!take}", out=say.OUT
        )
        delete = say.command(
            "delete the car", say.always(deleted), "verb", say.NAMED,
            verb="{!delete}|(can|could|may|should) [it|he|she|they] [go|leave|come out]|out with|gone|out of "
                 "[the|this] [scene|picture|video|clip|image|shot|frame|view|movie|film]|[no longer|not] (be) "
                 "there (any more)|[can|could|may|should|must|has to|have to|needs to|need to] [go|leave|get "
                 "out|come out|come off|be out] (away|out|the [scene|picture|video|clip|image|shot|frame|"
                 "view])|bye bye|goodbye|no more|no longer [want|need] (to see)|[i|we] would (rather|prefer) "
                 "not (to) [have|see]|[i|we] do not [want|need] (to [see|have])|[i|we] do not like to [see|"
                 "have]|[i|we] can not stand|[i|we] hate|[i|we] am [tired|sick] of",
            out=say.OUT
            | say.literal(
                "completely|entirely|fully|for good|(in) there|in it|any more|anymore|any longer|"
                f"in [the|this|my|our] [{say.PICTURE}]"
            ),
        )  # fmt: skip
        return say.Sentences((all_but, without, take_out, delete))


@dataclass(frozen=True)
class Extract(Removal):
    """Leave nothing else."""

    TAG = "extract"
    select: SelectKind
    frames: Span | None = None
    """Alone from … to; None = always."""

    SEEN = "in the rest"
    ANSWERS = 1

    def chosen(self, rows: SplatRows) -> np.ndarray:
        return ~rows.chosen(self.select)

    @property
    def left(self) -> SelectKind:
        return self.select

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return the first of "keep only the dog and delete the rest", which says all."""
        return (
            (self,) if later.removes and later.select in (self.select, Not(self.select)) else super().followed_by(later)
        )

    def described(self) -> str:
        return f"keep only {whom(self.select)}" + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        return ()

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        leaving = frozenset(say.every_form("leave|let").split("|"))
        only = say.command(
            "keep only the dog", say.always(extracted), "only", say.NAMED,
            verb="{keep,isolate}|standing|want|(be) [left|visible|seen|shown|there|remaining]|stay|remain|"
                 "remains|lift|lift out|in it",
            only=say.phrase(
                "(on) [{isolate}|[i|we] (only|just) [want|need] (to see) only|[i|we] [only|just] [want|need|would like] (to "
                "see)|only|just|solely|on [its|his|her|their] own|by itself|all by itself|soloed|in isolation|isolated|nothing "
                "else|[nothing|nobody|no one|none] (else) [but|except (for)|other than]|and nothing else|no one else|and "
                "nobody else|exclusively]"
            )
            | say.literal("alone") + say.here(lambda reading, at: leaving.isdisjoint(reading.words)),
        )  # fmt: skip
        return say.Sentences((only,))


def extracted(who: SelectKind, when: When, _: SentenceContext) -> Change:
    """Return the removal of everything else."""
    return Extract(who, **when.effect)


def deleted(who: SelectKind, when: When, _: SentenceContext) -> Change:
    """Return a removal; Refusal for everything."""
    if who == All():
        raise Refusal("Nothing would be left; say what to remove, or 'hide everything' if that is meant.")
    return Delete(who, **when.effect)
