"""k-means of rows of numbers, with few rounds on a sample: groups need not converge, they only have to be compact."""

from __future__ import annotations

import numpy as np

BLOCK = 4096
"""Rows compared with all centres at once: the matrix of their distances stays small."""


def k_means(rows: np.ndarray, count: int, sample: int = 1 << 14, rounds: int = 5) -> np.ndarray:
    """Return at most `count` centres (k,D) float32 of `rows (n,D)`, after so many rounds on at most `sample` of them."""
    some = rows[np.random.default_rng(0).permutation(len(rows))[:sample]].astype(np.float32)
    centres = some[:count]
    for _ in range(rounds):
        centres = means(nearest(some, centres), np.ones(len(some)), some, len(centres)).astype(np.float32)
    return centres


def nearest(rows: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return (n,) int: which of `centres (k,D)` is nearest to each of `rows (n,D)`, block by block."""
    half = (centres**2).sum(1) / 2
    blocks = np.array_split(rows, max(1, len(rows) // BLOCK))
    return np.concatenate([(half - block @ centres.T).argmin(1) for block in blocks])


def means(index: np.ndarray, weight: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """Return (groups,C) float64 weighted means of `values (n,C)`; 0 for an empty group."""
    sums = np.stack([np.bincount(index, weight * column, groups) for column in values.T], 1)
    return sums / np.maximum(np.bincount(index, weight, groups), 1e-12)[:, None]
