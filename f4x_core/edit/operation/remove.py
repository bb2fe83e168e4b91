"""Take something out, or leave nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...language.refusal import Refusal
from ..change import Change, Looking, Reply, Span, check_span
from ..description import span_words, whom
from ..selects import Not, SelectKind
from ..state import Appearance

if TYPE_CHECKING:
    from ..splat_rows import SplatRows


class Removal(Change):
    """Base: what is chosen is not there; deleted rows stay with opacity 0."""

    LOOKS = UNCOVERS = NEEDS_WHOM = True
    frames: Span | None

    def __post_init__(self) -> None:
        """Validate."""
        check_span(self.frames)

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        """Gone, where it is for all times."""
        return rows if self.frames is not None else replace(rows, gone=rows.gone | chosen)

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        """With opacity 0."""
        return state.with_opacities(chosen, np.float32(0))

    @property
    def removes(self) -> bool:
        """Always."""
        return True


@dataclass(frozen=True)
class Delete(Removal):
    """Take it out."""

    TAG = "delete"
    select: SelectKind
    frames: Span | None = None
    """Gone from … to; None = always."""

    ANSWERS = -1

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """What is removed twice is removed; Refusal where nothing would be left."""
        if later.removes and later.select == self.select:
            return (self,)
        if later.removes and later.select == Not(self.select):
            raise Refusal("Nothing would be left; say for example 'keep only the dog' if the rest is to go.")
        return super().followed_by(later)

    def described(self) -> str:
        """Remove the dog."""
        return f"remove {whom(self.select)}" + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Both kinds of removal."""

        def make(answer: Any, who: SelectKind, _: Any) -> Removal:
            return Delete(who, answer.span) if answer.op == "delete" else Extract(who, answer.span)

        return (Reply(("delete", "keep_only"), "Delete it, or leave nothing else.", make, {}, "RemovalChange"),)


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
        """All others."""
        return ~rows.chosen(self.select)

    @property
    def left(self) -> SelectKind:
        """What is extracted."""
        return self.select

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Of "keep only the dog and delete the rest" the first says all."""
        return (
            (self,) if later.removes and later.select in (self.select, Not(self.select)) else super().followed_by(later)
        )

    def described(self) -> str:
        """Keep only the dog."""
        return f"keep only {whom(self.select)}" + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """With those of `Delete`."""
        return ()
