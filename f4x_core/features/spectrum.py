"""Chooses the width of the latent, by principal components of all teachers' features together. numpy alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .maps import FeatureMaps

WIDTHS = (8, 16, 32, 64)
"""Widths that the raster and the scene file support."""
KEPT = 0.6
"""Fraction of the variance of the stacked features that so many components must hold. Not more: the same surface has a cosine
of about 0.7 with itself from frame to frame (MobileNetV2, blackswan), so half of the variance is in no scene at all. A toy
world of 18 unrelated things gets 8: after the 600 steps of a distillation half of it loses 4.4 points of mIoU and twice as
much gains 0.7; wider latents only learn sooner (after 60 steps 16 are 35 points ahead)."""
SAMPLES = 6000
"""Cells of which the spectrum is estimated, all frames together: ten for each direction of a thousand channels."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Principal components of the stacked features of several teachers, each scaled to the same total variance."""

    means: tuple[np.ndarray, ...]
    """(C,) of each teacher."""
    scales: tuple[float, ...]
    """Divisor of each teacher's centred features: the root of their total variance."""
    values: np.ndarray
    """(S,) variances along the components, descending; S is the sum of all C."""
    vectors: np.ndarray
    """(S,S) components as rows."""

    @cached_property
    def kept(self) -> np.ndarray:
        """(S,) fraction of the variance that the first 1, 2, … components hold."""
        total = self.values.sum()
        return np.cumsum(self.values) / total if total > 0 else np.ones(len(self.values))

    def coordinates(self, features: Sequence[np.ndarray], width: int) -> np.ndarray:
        """Return (…,width) of one map (…,C) per teacher, all on the same grid; 0 beyond the last component."""
        stacked = np.concatenate(
            [(map_ - mean) / scale for map_, mean, scale in zip(features, self.means, self.scales, strict=True)], -1
        )
        found = stacked @ self.vectors[:width].T.astype(np.float32)
        return np.pad(found, [(0, 0)] * (found.ndim - 1) + [(0, width - found.shape[-1])])

    def width(self, min_kept: float = KEPT) -> int:
        """Return the smallest width that keeps at least `min_kept` of the variance; the largest there is where none does."""
        enough = [width for width in WIDTHS if self.kept[min(width, len(self.kept)) - 1] >= min_kept]
        return enough[0] if enough else WIDTHS[-1]

    def evidence(self) -> str:
        """Return one line for the needs table."""
        fractions = ", ".join(f"{width}: {self.kept[min(width, len(self.kept)) - 1]:.1%}" for width in WIDTHS)
        return f"variance of all teachers' features that so many components hold: {fractions}"


def measure_spectrum(maps: Sequence[FeatureMaps], frames: Sequence[int], seed: int = 0) -> Spectrum:
    """Return the spectrum of `maps` over clip frames `frames`.

    Teachers have different grids: a place is drawn in the picture, and each gives the cell that the place falls into.
    """
    rng = np.random.default_rng(seed)
    places = rng.random((len(frames), -(-SAMPLES // max(len(frames), 1)), 2))  # (row, column), 0 to 1
    stacks, means, scales = [], [], []
    for teacher in maps:
        grid = np.array(teacher.spec.grid)
        cells = (places * grid).astype(int)  # (F,n,2)
        picked = np.concatenate(
            [teacher.expand(teacher.row(t)[tuple(cells[i].T)].astype(np.float32)) for i, t in enumerate(frames)]
        )
        means.append(picked.mean(0))
        picked = picked - means[-1]
        scales.append(float(max(np.sqrt((picked**2).sum(1).mean()), 1e-12)))
        stacks.append(picked / scales[-1])
    stacked = np.concatenate(stacks, 1).astype(np.float64)
    values, vectors = np.linalg.eigh(stacked.T @ stacked / max(len(stacked), 1))  # ascending
    return Spectrum(tuple(means), tuple(scales), np.maximum(values[::-1], 0), vectors.T[::-1])
