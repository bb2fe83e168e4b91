"""Model only what the clip needs: what was chosen, by which evidence, and what it saved."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..priors import Priors

if TYPE_CHECKING:
    from ..gaussians.spawn import Room

MUCH_MOTION = 0.5
"""Above this moving fraction of all pixels the background is mostly hidden."""


@dataclass(frozen=True)
class Need:
    """One row of the needs table."""

    what: str
    """The thing that could have been modelled."""
    chosen: str
    """The part of it that is modelled."""
    evidence: str
    """The measurement that decided."""
    saved: str
    """Additional cost of a scene that models everything."""

    def row(self) -> dict[str, str]:
        """Return the row as plain values, for the scene file."""
        return asdict(self)


@dataclass(frozen=True)
class Shortage:
    """A set of Gaussians of which the clip asked for more than was allowed."""

    kind: str
    """`static` or `dynamic`."""
    room: Room
    """At the start."""
    lacking: int
    """Gaussians that the last round of growth wanted beyond what was allowed."""
    limited_by: str
    """The setting or grant that allowed no more."""

    def __str__(self) -> str:
        """Return a sentence part about the Gaussians that there was no room for."""
        if self.room.short:
            return (
                f"all that is {self.kind}: {self.room.asked:,} Gaussians asked for at the start,"
                f" {self.room.allowed:,} allowed then by {self.limited_by}"
            )
        return f"{self.lacking:,} more Gaussians at the last growth of what is {self.kind}, by {self.limited_by}"


def lack_in_words(shortages: Iterable[Shortage]) -> str:
    """Return the shortages as one, nothing where there is none."""
    lacking = "; ".join(map(str, shortages))
    return lacking and f"no room for {lacking}"


def moving_fraction(priors: Priors) -> float:
    """Return the fraction of all pixels that the mask calls moving."""
    return float(np.mean(priors.mask)) if priors.mask is not None else 0.0
