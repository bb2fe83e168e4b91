"""Scores of labels: softmax of cosines, several targets, and who is selected. Pure array arithmetic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import F4xError

TEMPERATURE = 0.07
"""Where a text encoder names none: the one that CLIP and LSeg are trained with (logit scale 1 / 0.07)."""
THRESHOLD = 0.5
"""A probability above which a label has the majority."""


def cosines(features: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the cosines (…,L) of `features (…,C)` with `labels (L,C)`; 0 where a feature is 0."""
    lengths = np.linalg.norm(features, axis=-1, keepdims=True)
    units = labels / np.maximum(np.linalg.norm(labels, axis=-1, keepdims=True), 1e-12)
    return features @ units.T / np.maximum(lengths, 1e-12)


def logistic(odds: np.ndarray | float) -> np.ndarray:
    """Return the probabilities of log-odds, which are clipped to -30 … 30, so that nothing overflows."""
    return 1 / (1 + np.exp(-np.clip(odds, -30, 30)))


def text_scores(features: np.ndarray, labels: np.ndarray, temperature: float | None = None) -> np.ndarray:
    """Return the probabilities (…,L) `softmax(cosine / temperature)` over the labels; their sum is 1.

    `features (…,C)` of any length, `labels (L,C)`. F4xError for no labels, widths that differ, or a temperature not above 0.
    """
    temperature = TEMPERATURE if temperature is None else temperature
    if len(labels) == 0:
        raise F4xError("There are no labels to compare with; give at least one word.")
    if features.shape[-1] != labels.shape[-1]:
        raise F4xError(f"Features of {features.shape[-1]} channels cannot meet labels of {labels.shape[-1]}.")
    if not temperature > 0:
        raise F4xError(f"The temperature {temperature} is not above 0.")
    logits = cosines(features, labels) / temperature
    weights = np.exp(logits - logits.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


def target_score(scores: np.ndarray, targets: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return (summed score (…), (…) bool: the best label is a target) of `scores (…,L)` for label indices `targets`."""
    targets = list(dict.fromkeys(targets))
    return scores[..., targets].sum(-1), np.isin(scores.argmax(-1), targets)


def select(scores: np.ndarray, target: int | Sequence[int], threshold: float = THRESHOLD) -> np.ndarray:
    """Return (…) bool: the targets' summed score reaches `threshold`, or the best label is a target (Feature4X, editing)."""
    total, best = target_score(scores, [target] if isinstance(target, int) else target)
    return (total >= threshold) | best


def average_precision(scores: np.ndarray, truth: np.ndarray) -> float:
    """Return the area under precision over recall of `scores` against bool `truth` of the same shape; NaN where nothing is true.

    Equal scores count as one step, so that the order of pixels plays no role.
    """
    scores, truth = np.ravel(scores), np.ravel(truth)
    order = np.argsort(-scores, kind="stable")
    hits = np.cumsum(truth[order])
    if not len(hits) or hits[-1] == 0:
        return float("nan")
    last = np.append(np.diff(scores[order]) != 0, True)  # last of each group of equal scores
    precision = hits[last] / (np.flatnonzero(last) + 1)
    recall = hits[last] / hits[-1]
    return float((np.diff(recall, prepend=0) * precision).sum())


def overlap(mask: np.ndarray, truth: np.ndarray) -> float:
    """Return the intersection over union of two bool arrays; 1 where both are empty."""
    union = (mask | truth).sum()
    return float((mask & truth).sum() / union) if union else 1.0
