"""Estimated run times: seconds of a task from the clip's size, fitted to measured tasks.

`seconds(kind) = a + b T P + c S + d S P` with T frames, P megapixels of a frame and S optimiser steps, in thousands; the last two
terms are the fit's alone. No coefficient is below 0, so that a larger clip never costs less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from f4x_core.errors import F4xError


@dataclass(frozen=True)
class Size:
    """The quantities that the cost of a clip depends on."""

    frames: int
    """Number of frames used."""
    megapixels: float
    """Size of one fitted frame."""
    steps: int = 0
    """Optimiser steps of the profile."""

    def terms(self, kind: str) -> list[float]:
        """Return the factors of the coefficients for a kind of task."""
        per_step = [self.steps / 1000, self.steps / 1000 * self.megapixels] if kind == "fit" else []
        return [1.0, self.frames * self.megapixels, *per_step]


@dataclass(frozen=True)
class CostModel:
    """Coefficients for each kind of task."""

    coefficients: Mapping[str, tuple[float, ...]]
    """Kind -> coefficients of `Size.terms`, in seconds of one core."""

    def seconds(self, size: Size, kinds: Sequence[str] | None = None) -> float:
        """Total seconds of one clip's tasks of these kinds, run one after the other; None means all kinds."""
        named = tuple(kinds) if kinds is not None else tuple(self.coefficients)
        return float(sum(np.dot(self.coefficients[kind], size.terms(kind)) for kind in named))


def fit_costs(measured: Sequence[tuple[Size, Mapping[str, float]]]) -> CostModel:
    """Fit the model to measurements by relative error, so that a small clip counts as much as a large one.

    Args:
        measured: size of a clip, and kind -> seconds of its tasks; every clip has the same kinds.

    Raises:
        F4xError: nothing was measured.
    """
    from scipy.optimize import nnls

    if not measured:
        raise F4xError("there is no finished task to learn the cost from; run a small batch first.")
    coefficients = {}
    for kind in measured[0][1]:
        seconds = np.array([times[kind] for _, times in measured])  # (clips,)
        terms = np.array([size.terms(kind) for size, _ in measured])  # (clips, terms)
        solution, _ = nnls(terms / seconds[:, None], np.ones(len(seconds)))
        coefficients[kind] = tuple(float(value) for value in solution)
    return CostModel(coefficients)
