"""Principal components of features as red, green and blue, so that maps of many channels can be shown. numpy alone.

Basis and ranges are fitted once over all frames, so that equal features have equal colours in every view and session.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OUTLIERS = 1.0
"""Percent of the values that may saturate at either end of the colour range."""


@dataclass(frozen=True, eq=False)
class Pca:
    """Three directions in the space of features (…,C), and the range of values along each that is shown as 0..255."""

    mean: np.ndarray
    """(C,) float32."""
    basis: np.ndarray
    """(3,C) float32, orthonormal rows, the largest component of each positive; rows of 0 where C or the rank is below 3."""
    low: np.ndarray
    """(3,) coordinate that is shown as 0."""
    high: np.ndarray
    """(3,) coordinate that is shown as 255."""

    def coordinates(self, features: np.ndarray) -> np.ndarray:
        """Return (…,3) of features (…,C)."""
        return (features - self.mean) @ self.basis.T

    def to_unit_range(self, features: np.ndarray) -> np.ndarray:
        """Return (…,3) of features (…,C): linear, 0 where `colours` gives 0 and 1 where it gives 255; not clipped."""
        return self._between(self.coordinates(features))

    def colours(self, coordinates: np.ndarray) -> np.ndarray:
        """Return (…,3) uint8 of `coordinates (…,3)`."""
        return np.round(np.clip(self._between(coordinates), 0, 1) * 255).astype(np.uint8)

    def to_rgb(self, features: np.ndarray) -> np.ndarray:
        """Return (H,W,3) uint8 of features (H,W,C)."""
        return self.colours(self.coordinates(features))

    def _between(self, coordinates: np.ndarray) -> np.ndarray:
        return (coordinates - self.low) / np.maximum(self.high - self.low, 1e-12)


def fit_pca(samples: np.ndarray) -> Pca:
    """Return the three directions of largest variance of `samples (n,C)` and their 1 % and 99 % quantiles.

    Features of length 1 keep it: nothing is scaled. Without samples everything is 0.
    """
    samples = np.asarray(samples, np.float64)
    channels = samples.shape[1]
    if not len(samples):
        return Pca(np.zeros(channels, np.float32), np.zeros((3, channels), np.float32), np.zeros(3), np.zeros(3))
    mean = samples.mean(0)
    centred = samples - mean
    _, vectors = np.linalg.eigh(centred.T @ centred)  # ascending
    basis = np.zeros((3, channels))
    basis[: min(3, channels)] = vectors[:, ::-1][:, :3].T
    largest = np.take_along_axis(basis, np.abs(basis).argmax(1)[:, None], 1)
    basis *= np.where(largest < 0, -1, 1)  # eigenvectors have no sign of their own
    low, high = np.percentile(centred @ basis.T, [OUTLIERS, 100 - OUTLIERS], axis=0)
    return Pca(mean.astype(np.float32), basis.astype(np.float32), low, high)
