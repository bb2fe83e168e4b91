"""Model only what the clip needs: what was chosen, by which evidence, and what it saved."""

from dataclasses import asdict, dataclass

import numpy as np

from ..priors import Priors

MUCH_MOTION = 0.5
"""Above this moving share (of all pixels) the background is mostly hidden."""


@dataclass(frozen=True)
class Need:
    """One row of the needs table."""

    what: str
    """The thing that could have been modelled."""
    chosen: str
    """How much of it is modelled."""
    evidence: str
    """The measurement that decided."""
    saved: str
    """What a scene that models everything would have spent in addition."""

    def row(self) -> dict[str, str]:
        """The row as plain values, for the scene file."""
        return asdict(self)


def moving_fraction(priors: Priors) -> float:
    """Fraction of all pixels that the mask calls moving."""
    return float(np.mean(priors.mask)) if priors.mask is not None else 0.0
