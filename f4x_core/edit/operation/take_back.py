"""An earlier edit switched off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, ClassVar

from ...errors import F4xError
from ..change import Change, Reply
from ..selects import MAX_WORDS_LENGTH, All, SelectKind

if TYPE_CHECKING:
    from ..english import Sentences
    from ..stack import Edit


LAST, ALL = 0, -1
"""The last sentence, all sentences: no edit has these ids."""


@dataclass(frozen=True)
class TakeBack(Change):
    """Earlier edits of the stack switched off; undoing this one switches them on again."""

    TAG = "take_back"
    edit: int = LAST
    """Id of the edit; `LAST` or `ALL` until planning finds those meant."""
    words: str = ""
    """The earlier edits in words, for people."""
    others: tuple[int, ...] = ()
    """Ids of more edits: all that one sentence takes back is one edit."""
    select: ClassVar[SelectKind] = All()  # type: ignore[misc]  # whoever that edit was for

    ACTS = False
    SEEN = "nowhere"

    @property
    def taken_back(self) -> tuple[int, ...]:
        return (self.edit, *self.others)

    def planned(self, edits: Sequence[Edit]) -> tuple[TakeBack, ...]:
        """Return one operation that takes back all edits in effect, or those of the last sentence, the last one first."""
        if self.edit not in (LAST, ALL):
            return (self,)
        active = [edit for edit in reversed(edits) if edit.in_effect]
        if not active:
            raise F4xError("No edit is in effect that could be taken back.")
        if self.edit == LAST:
            last = active[0]
            active = [
                *takewhile(lambda edit: edit is last or (last.sentence and edit.sentence == last.sentence), active)
            ]
        words = "; ".join(edit.operation.described() for edit in active)[:MAX_WORDS_LENGTH]
        return (TakeBack(active[0].id, words, tuple(edit.id for edit in active[1:])),)

    def described(self) -> str:
        if self.edit in (LAST, ALL):
            return "take back the last edit" if self.edit == LAST else "take back all edits"
        if self.others:
            return f"take back {len(self.taken_back)} edits" + (f": {self.words}" if self.words else "")
        return f"take back '{self.words}'" if self.words else f"take back the edit of id {self.edit}"

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        edit = "[edit|change|step|command|one|thing]"
        verb = "[undo|revert|[take|takes|taking] back]"
        phrases = {
            f"{verb} (that|it|this|(the|my|that) [last|previous] {edit})|take [that|this] back": LAST,
            f"{verb} [everything|all|all (of) (the|my|these) [edits|changes|steps]|every {edit}]": ALL,
        }
        take = lambda undo: lambda *_: cls(undo)  # noqa: E731
        undo = say.command("take back the last edit", take, "undo", say.Use(alone=True), say.nobody, undo=phrases)
        return say.Sentences(early=(undo,))

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        return ()
