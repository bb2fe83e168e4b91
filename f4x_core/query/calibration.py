"""From cosines to probabilities: whether a word's object is in this scene at all, and where it ends. Needs numpy alone.

A teacher ranks the parts of a scene well, but the level of its scores differs by word and by scene. Three steps make a
probability of them. Votes of neighbours smooth the log-odds (`smoothing`). A mixture of two normal distributions,
weighted by blend weights, splits them at the scene's own gap. The `evidence` in either half, on a scale common to all words
and scenes, decides whether the word is present in it: in both where it fills the scene, in none where it is absent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..features.null import null_vector
from ..scene import Scene
from .labels import TextQuery
from .objects import graph_of
from .outlines import views_of_outlines
from .score import TEMPERATURE, THRESHOLD, cosines, logistic
from .smoothing import Patches, group_of

PRESENT, DOUBT = 0.26, 0.03
"""Evidence at which an object is present with probability 0.5, and the step of evidence that multiplies the odds by e."""
ROUNDS, SETTLED = 100, 1e-9
"""Maximum rounds of expectation-maximisation, and the change of the fraction below which it has converged."""
LEAKS = 0.9
"""Static Gaussians are what a mover's word leaks onto where their mean probability is less than this fraction of the mover's.
Chosen on one dog; a camel, two cars and a horse lose at most 13 Gaussians, of 1,100 and more, at their rims."""
MIN_SPREAD = 0.01
"""Minimum standard deviation of a half: latents stored in bytes are no finer."""


@dataclass(frozen=True, eq=False)
class Split:
    """A mixture of two normal distributions: the low half and the high half of weighted values."""

    high: np.ndarray
    """(P,) in [0, 1]: probability of the high half."""
    means: tuple[float, float]
    """Of the low and the high half."""
    fraction: float
    """Fraction of the weight in the high half."""


def evidence(features: np.ndarray, labels: np.ndarray, null: np.ndarray) -> np.ndarray:
    """Return (…,L): the distance of unit `features (…,C)` from `null (C,)` toward `labels (L,C)`; 0 = no evidence."""
    units = features / np.maximum(np.linalg.norm(features, axis=-1, keepdims=True), 1e-12)
    towards = labels / np.maximum(np.linalg.norm(labels, axis=-1, keepdims=True), 1e-12) - null
    return (units - null) @ (towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-12)).T


def split(values: np.ndarray, weights: np.ndarray) -> Split:
    """Fit the mixture to `values (P,)` with `weights (P,)`, by expectation-maximisation from Otsu's threshold.

    Beyond the two means the nearer half wins, so that `high` never falls where a value rises: the wider of two normal
    distributions would otherwise win at both ends.
    """
    weights = weights / weights.sum()
    high = (values > _otsu(values, weights)).astype(float)
    means = np.full(2, weights @ values)
    fraction = 0.0
    for _ in range(ROUNDS):
        before, fraction = fraction, float(weights @ high)
        if not 1e-6 < fraction < 1 - 1e-6 or abs(fraction - before) < SETTLED:
            break
        parts = np.stack([weights * (1 - high), weights * high]) / [[1 - fraction], [fraction]]
        means = parts @ values
        variances = (parts * (values - means[:, None]) ** 2).sum(1) + MIN_SPREAD**2
        distance = (values - means[:, None]) ** 2 / variances[:, None]
        odds = np.log(fraction / (1 - fraction)) + 0.5 * (
            np.log(variances[0] / variances[1]) + distance[0] - distance[1]
        )
        odds = np.where(
            values >= means[1], np.maximum(odds, 0), np.where(values <= means[0], np.minimum(odds, 0), odds)
        )
        high = logistic(odds)
    return Split(high, (float(means[0]), float(means[1])), fraction)


def prepare(scene: Scene) -> None:
    """Group the scene, draw the views that show outlines and decode the features that words need: the first query then is as fast
    as later ones."""
    graph_of(scene)
    if scene.moving.any():
        views_of_outlines(scene.base)
    if scene.features is None:
        return
    patches = group_of(scene)
    for head in scene.require_field().heads:
        if head.spec.text_encoder is not None:
            patches.features(head)


def word_probabilities(scene: Scene, query: TextQuery) -> np.ndarray | None:
    """Return the probability (N,) float64 that a Gaussian belongs to a target; None where the encoder has no null vector.

    The best of several targets counts, each weighed against the query's other words.
    """
    null = null_vector(query.head.spec.text_encoder or "")
    if null is None:
        return None
    patches, targets = group_of(scene), query.targets
    features = patches.features(query.head)
    odds = cosines(features, query.vectors) / (query.head.spec.temperature or TEMPERATURE)
    if odds.shape[1] > targets:
        odds -= np.logaddexp.reduce(odds[:, targets:], axis=1, keepdims=True)
    seen = evidence(features, query.vectors[:targets], null)
    each = [_probability(patches, odds[:, one], seen[:, one]) for one in range(targets)]
    return np.max([without_leaks(one[patches.index], scene.moving) for one in each], axis=0)


def without_leaks(probability: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Return the probability (N,) of a label, 0 for static Gaussians that answer clearly less where most that has it moves.

    They are what is behind: the grass of a dog has .8 of its probability, the second camel of a herd, which stands, .97.
    """
    own, rest = (probability >= THRESHOLD) & moving, (probability >= THRESHOLD) & ~moving
    if own.sum() <= rest.sum() or not rest.any() or probability[rest].mean() >= LEAKS * probability[own].mean():
        return probability
    return np.where(rest, 0.0, probability)


def _probability(patches: Patches, odds: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the probability (P,) of a label from its log-odds (P,) and its evidence (P,), split by the scene itself."""
    weight = patches.weight
    parts = split(patches.smooth(odds), weight)

    def there(half: np.ndarray) -> float:
        mass = half * weight
        return float(logistic((mass @ seen / max(mass.sum(), 1e-12) - PRESENT) / DOUBT))

    low, high = there(1 - parts.high), there(parts.high)
    return np.minimum(low, high) + (high - min(low, high)) * parts.high


def _otsu(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the threshold with the greatest variance between the values below and above it (Otsu 1979)."""
    order = np.argsort(values)
    ordered, mass = values[order], np.cumsum(weights[order])
    below = np.cumsum(weights[order] * ordered)
    between = (below[-1] * mass - below) ** 2 / np.maximum(mass * (1 - mass), 1e-12)
    return float(ordered[np.argmax(between[:-1])]) if len(values) > 1 else float(ordered[0])
