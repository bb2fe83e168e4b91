"""The decision of the camera stage between a solution and its mirror image, in which near and far are exchanged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scipy.special import expit

from ..priors import Priors
from ..priors.mirror import LIKELY, SURE, Evidence

MAX_ODDS = 1000
"""Odds beyond this are not told apart in sentences."""


@dataclass(frozen=True)
class WayRound:
    """The chosen one of two solutions, near and far as errors have it or exchanged, and its certainty."""

    verdict: str
    """`sure`, `likely` or `toss-up`."""
    chosen: str
    """`least error` or `mirrored`."""
    margin: float
    """Log-odds in favour of the chosen solution, natural logarithm."""
    clues: tuple[Evidence, ...]
    """Evidence that decided, the strongest first."""

    @classmethod
    def of(cls, priors: Priors) -> WayRound | None:
        """Read `statistics["cameras"]["mirror"]` of the priors; None where the camera stage compared nothing."""
        entry: dict[str, Any] | None = priors.statistics.get("cameras", {}).get("mirror")
        if not entry:
            return None
        margin = entry.get("margin")  # files of JSON keep no infinity: it is None there
        if margin is None:
            margin = {"sure": SURE, "likely": LIKELY}.get(str(entry.get("verdict")), 0.0)
        clues = [
            Evidence(str(clue.get("what", "")), float(clue.get("for") or 0.0), str(clue.get("detail", "")))
            for clue in entry.get("evidence", [])
        ]
        clues.sort(key=lambda clue: -abs(clue.log_odds))
        verdict = "sure" if margin >= SURE else "likely" if margin >= LIKELY else "toss-up"
        return cls(entry.get("verdict", verdict), entry.get("chosen", "least error"), float(margin), tuple(clues))

    @property
    def probability_wrong(self) -> float:
        """0..1: that near and far are exchanged."""
        return float(expit(-self.margin))

    @property
    def odds(self) -> str:
        """The margin in words, for example `12 to 1`."""
        odds = math.exp(min(max(self.margin, 0.0), math.log(MAX_ODDS)))
        if odds >= 0.999 * MAX_ODDS:
            return f"more than {MAX_ODDS:,} to 1"
        return f"{odds:.0f} to 1" if odds >= 10 else f"{odds:.1f} to 1"
