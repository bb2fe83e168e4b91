"""An earlier edit switched off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..change import Change, Reply
from ..selects import All, SelectKind


@dataclass(frozen=True)
class TakeBack(Change):
    """An earlier edit of the stack switched off; undoing this one switches it on again."""

    TAG = "take_back"
    edit: int
    """Id of the edit."""
    words: str = ""
    """What it did, for people."""
    select: ClassVar[SelectKind] = All()  # type: ignore[misc]  # whoever that edit was for

    ACTS = False
    SEEN = "nowhere"

    @property
    def taken_back(self) -> int:
        """That edit."""
        return self.edit

    def described(self) -> str:
        """What it did."""
        return f"take back '{self.words}'" if self.words else f"take back the edit of id {self.edit}"

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """None."""
        return ()
