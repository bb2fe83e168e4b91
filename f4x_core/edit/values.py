"""Values: functions from a target and a time to an operation, of which sentences are made. Needs no grammar."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from ..language.degrees import Amount, Degree, degree_of, factor
from ..language.refusal import Final, Mismatch
from .selects import SelectKind

if TYPE_CHECKING:
    from .change import Change
    from .phrases import SentenceContext, When

Value = Callable[[SelectKind, "When", "SentenceContext"], "Change"]
"""A function from a target, a time and a context to an operation: "red", "twice as big"."""
Making = Callable[[float], Value]
"""A value from a factor."""
Graded = Callable[[Amount | None, bool], Value]
"""A value from how much, and whether more or less; Mismatch where there is no such amount of it."""
Given = Value | tuple[tuple[Value], ...]
"""A value, or several as `listed` gives them."""


def refused(reason: str) -> Value:
    """Return a value that raises `reason`: the words are understood, but cannot be carried out."""

    def value(*_: Any) -> Change:
        raise Final(reason)

    return value


def graded(
    make: Making, of: Callable[[Degree], tuple[float, float]] = attrgetter("factors"), gone: bool = True
) -> Graded:
    """Return the value that `make` gives for a factor within its range; `of`: as in `factor`; `gone`: 0 is allowed."""

    def changed(how: Amount | None, upward: bool) -> Value:
        by = factor(how, upward, of)
        if how is not None and how.kind == "times" and upward and by < 1:
            return refused(f"{by:g} times as much is less, not more; say for example 'twice as much'.")
        if how is not None and by == 1:
            return refused("That changes nothing; say for example 'by 20 %'.")
        if by < 0 or not (by or gone):
            return refused("Nothing would be left of it; say for example 'by 50 %'.")
        return make(by)

    return changed


def only_more(make: Callable[[Amount | None], Value]) -> Graded:
    """Return a value for a quality that nothing has by itself, so that less of it is refused."""

    def changed(how: Amount | None, upward: bool) -> Value:
        if not upward:
            raise Mismatch
        return make(how)

    return changed


def strong(usual: float, how: Amount | None, most: float = 1.0) -> float:
    """Return the usual strength, a degree of it up to `most`, or a multiple of it; Mismatch for other amounts."""
    if degree := degree_of(how):
        return min(usual * degree.share, most)
    if how is None or how.kind not in ("times", "as") or how.value < 1:
        raise Mismatch
    return usual * how.value
