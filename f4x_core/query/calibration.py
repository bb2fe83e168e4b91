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
from .labels import BACKGROUND, TextQuery
from .objects import graph_of
from .score import TEMPERATURE, cosines, logistic
from .smoothing import Patches, group_of

PRESENT, DOUBT = 0.26, 0.03
"""Evidence at which an object is present with probability 0.5, and the step of evidence that multiplies the odds by e."""
CANDIDATE = 0.01
"""Fraction of the blend weights that a word of the vocabulary must win to be looked for when the query is a surface."""
ROUNDS, SETTLED = 100, 1e-9
"""Maximum rounds of expectation-maximisation, and the change of the fraction below which it has converged."""
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
    """(…,L): how far unit `features (…,C)` lie from the `null (C,)` in the direction of `labels (L,C)`; 0 = no evidence."""
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
    """Group the scene and decode the features that words need, so that the first query is as fast as later ones."""
    graph_of(scene)
    if scene.features is None:
        return
    patches = group_of(scene)
    for head in scene.require_field().heads:
        if head.spec.text_encoder is not None:
            patches.features(head)


def word_probabilities(scene: Scene, query: TextQuery) -> np.ndarray | None:
    """(N,) float64 in [0, 1]: probability that a Gaussian belongs to a target; None where the encoder has no null vector.

    The best of several targets counts. Things are looked for by `_thing`. Of surfaces (`labels.BACKGROUND`) teachers of
    things know little beyond which one it would rather be: they compete with one another alone, for what no thing takes.
    """
    null = null_vector(query.head.spec.text_encoder or "")
    if null is None:
        return None
    space = _Space(group_of(scene), query, null)
    asked = [label.lower() for label in query.labels]
    best, free = np.zeros(len(space.features)), None
    for target, vector in enumerate(query.vectors[: query.targets]):
        if {asked[target], *asked[query.targets :]} <= set(BACKGROUND):
            free = _no_thing(space, scene) if free is None else free
            probability = np.minimum(free, _surface(space, vector))
        else:
            probability = _thing(space, vector)
        best = np.maximum(best, probability)
    return best[space.patches.index]


class _Space:
    """The patches of a scene, decoded for one query."""

    def __init__(self, patches: Patches, query: TextQuery, null: np.ndarray):
        self.patches, self.null, self.encoder = patches, null, query.head.spec.text_encoder or ""
        self.features = patches.features(query.head)  # (P,C)
        self.temperature = query.head.spec.temperature or TEMPERATURE
        self.rivals = cosines(self.features, query.vectors[query.targets :]) / self.temperature  # (P,R)

    def logits(self, vector: np.ndarray) -> np.ndarray:
        """(P,) of the label `vector (C,)`."""
        return cosines(self.features, vector[None])[:, 0] / self.temperature


def _thing(space: _Space, vector: np.ndarray) -> np.ndarray:
    """(P,): probability of the label `vector (C,)` against the query's other words, split by the scene itself."""
    odds = space.logits(vector)
    if space.rivals.shape[1]:
        odds = odds - np.logaddexp.reduce(space.rivals, axis=1)
    weight = space.patches.weight
    parts = split(space.patches.smooth(odds), weight)
    seen = evidence(space.features, vector[None], space.null)[:, 0]

    def there(half: np.ndarray) -> float:
        mass = half * weight
        return float(logistic((mass @ seen / max(mass.sum(), 1e-12) - PRESENT) / DOUBT))

    low, high = there(1 - parts.high), there(parts.high)
    return np.minimum(low, high) + (high - min(low, high)) * parts.high


def _surface(space: _Space, vector: np.ndarray) -> np.ndarray:
    """(P,): probability of the label `vector (C,)` against the best of the query's other words."""
    return logistic(space.patches.smooth(space.logits(vector) - space.rivals.max(1)))


def _no_thing(space: _Space, scene: Scene) -> np.ndarray:
    """(P,): probability that none of the vocabulary's things is there."""
    labels, vectors = scene.require_field().vocabulary(space.encoder)
    best = evidence(space.features, vectors, space.null).argmax(1)
    won = np.bincount(best, space.patches.weight, len(labels)) / space.patches.weight.sum()
    free = np.ones(len(best))
    for label, vector, fraction in zip(labels, vectors, won, strict=True):
        if fraction >= CANDIDATE and label.lower() not in BACKGROUND:
            free = np.minimum(free, 1 - _thing(space, vector))
    return free


def _otsu(values: np.ndarray, weights: np.ndarray) -> float:
    """The threshold with the greatest variance between what lies below and above it (Otsu 1979)."""
    order = np.argsort(values)
    ordered, mass = values[order], np.cumsum(weights[order])
    below = np.cumsum(weights[order] * ordered)
    between = (below[-1] * mass - below) ** 2 / np.maximum(mass * (1 - mass), 1e-12)
    return float(ordered[np.argmax(between[:-1])]) if len(values) > 1 else float(ordered[0])
