"""Finding of the diagnosis: its weight, the measurement, and what a person can do about it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

MOVING_DEPTH = "The depth of what moves"
"""Begins every finding about it."""
PATH, CAMERAS, MOVES, UNSEEN, ROOM, SCORE = "path", "cameras", "what moves", "unseen frames", "room", "score"
"""Causes: a camera path that cannot show it, wrong cameras, motion that is not followed, a scene that does not carry over to frames
that were not used, too few Gaussians; `SCORE` is none, but a poor picture, for whatever cause."""
Weight = Literal["problem", "note", "good"]
ORDER: tuple[Weight, ...] = ("problem", "note", "good")


@dataclass(frozen=True)
class Finding:
    """Statement about a scene that a person should know."""

    weight: Weight
    """`problem` costs quality, `note` is worth knowing, `good` is fine."""
    what: str
    """Measurement, one sentence."""
    advice: str = ""
    """Action or input that would help; empty when there is nothing to do."""
    cause: str = ""
    """Findings of one cause become one (`by_cause`); empty: it has its own."""


problem, note, good = (partial(Finding, weight) for weight in ORDER)
"""Make a finding of that weight: what is measured, then `advice` and `cause`."""


def caused_by(cause: str, found: Iterable[Finding]) -> list[Finding]:
    """Return the findings with a cause."""
    return [replace(one, cause=cause) for one in found]


def by_cause(found: Sequence[Finding]) -> list[Finding]:
    """Return the findings, problems first: those of one cause as one, with the advice of the problems, else the first.

    That the pictures are poor is no problem of its own where a problem says why.
    """
    why = any(one.weight == "problem" and one.cause != SCORE for one in found)
    groups: dict[str | int, list[Finding]] = {}
    for number, one in enumerate(found):
        weighed = replace(one, weight="note") if one.cause == SCORE and why else one
        groups.setdefault(one.cause or number, []).append(weighed)
    return by_weight(map(_as_one, groups.values()))


def by_weight(found: Iterable[Finding]) -> list[Finding]:
    """Return the problems first; among equals the order stays."""
    return sorted(found, key=lambda one: ORDER.index(one.weight))


def _as_one(group: Sequence[Finding]) -> Finding:
    group = by_weight(group)
    first = group[0]
    advice = list(dict.fromkeys(one.advice for one in group if one.weight == first.weight and one.advice))
    advice = advice if first.weight == "problem" else advice[:1]
    return replace(first, what=" ".join(dict.fromkeys(one.what for one in group)), advice=" ".join(advice))
