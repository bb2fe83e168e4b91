"""An earlier edit switched off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, ClassVar

from ...errors import F4xError
from ..change import Change, Reply
from ..selects import All, SelectKind

if TYPE_CHECKING:
    from ..english import Said
    from ..stack import Edit


LAST = 0
"""No edit has this id."""


@dataclass(frozen=True)
class TakeBack(Change):
    """An earlier edit of the stack switched off; undoing this one switches it on again."""

    TAG = "take_back"
    edit: int = LAST
    """Id of the edit; `LAST` until planning finds the last sentence."""
    words: str = ""
    """The earlier edit in words, for people."""
    select: ClassVar[SelectKind] = All()  # type: ignore[misc]  # whoever that edit was for

    ACTS = False
    SEEN = "nowhere"

    @property
    def taken_back(self) -> int:
        return self.edit

    def planned(self, edits: Sequence[Edit]) -> tuple[TakeBack, ...]:
        """All edits of the last sentence in effect, the last one first."""
        active = [edit for edit in edits if edit.enabled and edit.operation.taken_back is None]
        if self.edit != LAST:
            return (self,)
        if not active:
            raise F4xError("No edit is in effect that could be taken back.")
        said = active[-1].sentence
        last = takewhile(lambda edit: edit is active[-1] or (said and edit.sentence == said), reversed(active))
        return tuple(TakeBack(edit.id, edit.operation.described()) for edit in last)

    def described(self) -> str:
        if self.edit == LAST:
            return "take back the last edit"
        return f"take back '{self.words}'" if self.words else f"take back the edit of id {self.edit}"

    @classmethod
    def said(cls) -> Said:
        from .. import english as say

        last = "(that|it|this|(the|my|that) [last|previous] [edit|change|step|command|one|thing])"
        undo = say.command(
            "take back the last edit", say.always(lambda *_: cls()), "undo", say.Use(alone=True), say.nobody,
            undo=f"[undo|revert|[take|takes|taking] back] {last}|take [that|this] back",
        )  # fmt: skip
        return say.Said(early=(undo,))

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        return ()
