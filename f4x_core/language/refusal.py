"""Sentences that are not understood, in doubt, or ask for what cannot be. Needs no grammar."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import F4xError


class Refusal(F4xError):  # noqa: N818  # nothing went wrong
    """A sentence that is not understood, or asks for what cannot be."""

    def __init__(self, reason: str, nearest: tuple[str, ...] = ()):
        """Give the reason, one sentence; `nearest` are commands that are known, as example sentences."""
        hint = " Try: " + "; ".join(f'"{example}"' for example in nearest) + "." if nearest else ""
        super().__init__(reason + hint)
        self.reason = reason
        self.nearest = nearest

    def behind(self, notes: Sequence[str]) -> Refusal:
        """Return the refusal with notes before its reason."""
        return Refusal(" ".join([*notes, self.reason]), self.nearest)


class Final(Refusal):
    """A sentence that is understood and cannot be carried out, so that no other reading of it is looked for."""


class Doubt(Refusal):
    """A sentence that would be understood if a word were spelt otherwise or left out: it is asked about, and not done."""

    def __init__(self, reason: str, instead: str):
        """Give the reason; `instead` is the sentence that was probably meant."""
        super().__init__(reason)
        self.instead = instead

    def behind(self, notes: Sequence[str]) -> Doubt:
        """Return the doubt with notes before its reason."""
        return type(self)(" ".join([*notes, self.reason]), self.instead)


class Slip(Doubt):
    """A word of the language itself that is misspelt, where nothing would be removed: it is mended, and that is said."""


class Mismatch(Exception):  # noqa: N818  # it never leaves the grammar
    """The words fit a rule and their meaning does not."""
