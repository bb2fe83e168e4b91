"""A name for a selection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..change import Change, Reply, check_name
from ..description import whom
from ..selects import SelectKind
from ..splat_rows import with_name

if TYPE_CHECKING:
    from ..splat_rows import SplatRows


@dataclass(frozen=True)
class Name(Change):
    """A name for a selection, to be used by later operations. Changes nothing that is seen."""

    TAG = "name"
    select: SelectKind
    name: str
    """Letters, digits, spaces, - and _; a later `name` of the same name replaces it."""

    def __post_init__(self) -> None:
        """Validate."""
        check_name(self.name)

    ACTS = False
    SEEN = "nowhere"

    def rows_without(self, rows: SplatRows) -> SplatRows:
        """What was named once stays named, or edits after it would mean nobody."""
        return with_name(rows, self.name, np.flatnonzero(self.chosen(rows)))

    def described(self) -> str:
        """Call the dog "rex"."""
        return f'call {whom(self.select)} "{self.name}"'

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """The name."""

        def make(answer: Any, who: SelectKind, _: Any) -> Name:
            return cls(who, answer.name)

        return (Reply(("name",), "A name for it.", make, {"name": str}, "NameSelection", timed=False),)
