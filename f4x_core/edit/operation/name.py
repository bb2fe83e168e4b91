"""A name for a selection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..change import Change, Reply, check_name
from ..description import whom
from ..selects import SelectKind
from ..splat_rows import with_name
from ..values import Value

if TYPE_CHECKING:
    from ..english import Sentences
    from ..phrases import SentenceContext, When
    from ..splat_rows import SplatRows


@dataclass(frozen=True)
class Name(Change):
    """A name for a selection, to be used by later operations. Changes nothing that is seen."""

    TAG = "name"
    select: SelectKind
    name: str
    """Letters, digits, spaces, - and _; a later `name` of the same name replaces it."""

    def __post_init__(self) -> None:
        check_name(self.name)

    ACTS = False
    SEEN = "nowhere"

    def rows_without(self, rows: SplatRows) -> SplatRows:
        """Keep the name where it is switched off, or edits after it would mean nobody."""
        return with_name(rows, self.name, np.flatnonzero(self.chosen(rows)))

    def described(self) -> str:
        return f'call {whom(self.select)} "{self.name}"'

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:

        def make(answer: Any, who: SelectKind, _: Any) -> Name:
            return cls(who, answer.name)

        return (Reply(("name",), "A name for it.", make, {"name": str}, "NameSelection", timed=False),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        ending = say.word_set("and then but so please now from")
        name = say.command(
            "call the dog rex", named, "verb called", say.NAMED, verb="{=call/name/label/tag/dub/nickname/rename/relabel}",
            called=say.phrase("(as|to)")
            + say.here(lambda reading, at: reading.word(at - 1) not in ("the", "my", "that", "this"))
            + say.unless(say.here(lambda reading, at: reading.word(at) in say.IMPERATIVES))
            + say.name
            + say.here(lambda reading, at: not reading.word(at).isalpha() or reading.word(at) in ending),
        )  # fmt: skip
        return say.Sentences((name,))


def named(called: str) -> Value:
    """Return the naming of a selection; Refusal for a name that means something else."""
    from ..phrases import refuse_as_name

    refuse_as_name(called)

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        return Name(who, context.names.setdefault(called.lower(), called), **when.none("A name"))

    return value
