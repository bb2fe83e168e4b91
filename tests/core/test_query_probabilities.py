"""From cosines to probabilities on a few made-up patches, worked out patch by patch."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from f4x_core.query import calibration
from f4x_core.query.calibration import _otsu, evidence, split, without_leaks, word_probabilities
from f4x_core.query.labels import BACKGROUND, TextQuery

RNG = np.random.default_rng(4)
NULL = np.array([0.5, 0.5, 0.5, 0.5, 0, 0])
WEIGHT = 0.05 * RNG.random(8) + 0.01  # together below 1: no bound may lift a sum
FEATURES = 0.3 * (NULL + RNG.normal(size=(8, 6)))
INDEX = np.array([3, 3, 0, 1, 7, 6, 5, 4, 2, 0])
WORDS = {word: 0.4 * (NULL + RNG.normal(size=6)) for word in ("swan", "boat", "Wall", "sky", "goose", "grass")}


def smooth(values):
    return 0.5 * values + 0.25


def sigmoid(odds):
    return 1 / (1 + math.exp(-odds))


def cosine(one, other):
    return one @ other / math.sqrt((one @ one) * (other @ other))


def otsu_by_trial(values, weights):
    """Of the values but the greatest: what lies up to it and above it have means that differ most, weighed."""
    best = (-1.0, None)
    for threshold in sorted(values)[:-1]:
        low, high = weights * (values <= threshold), weights * (values > threshold)
        if low.sum() and high.sum():
            apart = (low @ values / low.sum() - high @ values / high.sum()) ** 2 * low.sum() * high.sum()
            if apart > best[0] * (1 + 1e-12):
                best = apart, threshold
    return best[1]


def split_by_loops(values, weights):
    """Expectation-maximisation: (probability of the high half, means, fraction)."""
    weights = weights / weights.sum()
    high = [float(value > otsu_by_trial(values, weights)) for value in values]
    fraction = -1.0
    for _ in range(calibration.ROUNDS):
        before, fraction = fraction, weights @ high
        if abs(fraction - before) < calibration.SETTLED:
            break
        own = [weights * (1 - np.array(high)) / (1 - fraction), weights * high / fraction]
        means = [part @ values for part in own]
        spreads = [part @ (values - mean) ** 2 + 0.01**2 for part, mean in zip(own, means, strict=True)]
        for i, value in enumerate(values):
            densities = [math.exp(-0.5 * (value - mean) ** 2 / spread) / math.sqrt(spread)
                         for mean, spread in zip(means, spreads, strict=True)]  # fmt: skip
            wins = fraction * densities[1] / (fraction * densities[1] + (1 - fraction) * densities[0])
            high[i] = max(wins, 0.5) if value >= means[1] else min(wins, 0.5) if value <= means[0] else wins
    return np.array(high), means, fraction


@pytest.mark.parametrize("rounds", [1, 2, 7, 100])
@pytest.mark.parametrize("seed", range(4))
def test_the_split_by_loops(monkeypatch, rounds, seed):
    monkeypatch.setattr(calibration, "ROUNDS", rounds)
    random = np.random.default_rng(seed)
    values = np.concatenate([random.normal(0, 0.05 + seed, 12), random.normal(2, 0.5, 9)])
    weights = 3 * random.random(21)
    found, (high, means, fraction) = split(values, weights), split_by_loops(values, weights)
    np.testing.assert_allclose(found.high, high, atol=1e-7)
    np.testing.assert_allclose(found.means, means, atol=1e-9)
    assert found.fraction == pytest.approx(fraction, abs=1e-9)


def test_the_split_of_equal_values_and_of_what_is_not_seen():
    flat = split(np.full(5, 0.3), np.ones(5))
    assert flat.means == (pytest.approx(0.3), pytest.approx(0.3)) and flat.fraction == 0 and not flat.high.any()
    unseen = split(np.array([0.0, 1, 1]), np.array([0.0, 1, 1]))
    assert unseen.fraction == 1 and unseen.high.tolist() == [0, 1, 1] and unseen.means == (1, 1)


@pytest.mark.parametrize("count", [2, 3, 5, 9, 14])
def test_otsus_threshold_by_trial(count):
    random = np.random.default_rng(count)
    for _ in range(5):
        values, weights = 3 * random.normal(size=count) + 1, random.random(count) ** 3
        weights = weights / weights.sum()
        assert _otsu(values, weights) == otsu_by_trial(values, weights)
    assert _otsu(np.array([0.7]), np.ones(1)) == 0.7


def test_evidence_of_each_feature_for_each_label():
    random = np.random.default_rng(1)
    features, labels = 0.2 * random.normal(size=(3, 4, 6)), 0.3 * random.normal(size=(5, 6)) + 0.2 * NULL
    found = evidence(features, labels, NULL)
    assert found.shape == (3, 4, 5)
    for i, j, k in np.ndindex(3, 4, 5):
        feature, label = (vector / np.linalg.norm(vector) for vector in (features[i, j], labels[k]))
        towards = (label - NULL) / np.linalg.norm(label - NULL)
        assert found[i, j, k] == pytest.approx((feature - NULL) @ towards)
    near = NULL + 0.01 * random.normal(size=(1, 6))  # a label much like the null vector has a direction too
    near = near / np.linalg.norm(near)
    expected = (near[0] - NULL) @ (near[0] - NULL) / np.linalg.norm(near[0] - NULL)
    assert evidence(near, near, NULL)[0, 0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("static", "kept"),
    [(0.7, False), (0.89, False), (0.95, True)],  # of grass, and of a second camel that stands
)
def test_what_stands_and_answers_clearly_less_than_the_mover_is_no_part_of_it(static, kept):
    moving = np.arange(10) < 5
    probability = np.where(moving, 0.99, static)
    probability[8:] = 0.3
    found = without_leaks(probability, moving)
    assert (found[5:8] == (static if kept else 0)).all() and (
        np.delete(found, [5, 6, 7]) == np.delete(probability, [5, 6, 7])
    ).all()
    np.testing.assert_array_equal(without_leaks(probability, ~moving), probability)  # most of it stands


@pytest.fixture(params=[0.2, None])
def temperature(monkeypatch, request):
    """Of the head, or the common one; presence is decided softly, so that numbers show."""
    patches = SimpleNamespace(weight=WEIGHT, features=lambda head: FEATURES, smooth=smooth, index=INDEX)
    monkeypatch.setattr(calibration, "group_of", lambda scene: patches)
    monkeypatch.setattr(calibration, "null_vector", {"words": NULL}.get)
    monkeypatch.setattr(calibration, "DOUBT", 0.4)
    return request.param


def asked(temperature, labels, targets):
    spec = SimpleNamespace(text_encoder="words", temperature=temperature)
    vectors = np.array([WORDS.get(label, np.roll(WORDS["swan"], len(label))) for label in labels])
    return TextQuery(SimpleNamespace(spec=spec), tuple(labels), vectors, targets)


def scene_with(words):
    table = np.array([WORDS[word] for word in words])

    def vocabulary(encoder):
        assert encoder == "words"
        return tuple(words), table

    field = SimpleNamespace(vocabulary=vocabulary)
    return SimpleNamespace(require_field=lambda: field, moving=np.zeros(len(INDEX), bool))


def thing(vector, rivals, temperature):
    """Probability of each patch: the split of its odds, and the evidence in either half."""
    odds = [cosine(f, vector) / temperature for f in FEATURES]
    if len(rivals):
        odds = [o - math.log(sum(math.exp(cosine(f, r) / temperature) for r in rivals))
                for o, f in zip(odds, FEATURES, strict=True)]  # fmt: skip
    parts = split(smooth(np.array(odds)), WEIGHT)
    seen = evidence(FEATURES, vector[None], NULL)[:, 0]
    low, high = (sigmoid((np.average(seen, weights=half * WEIGHT) - calibration.PRESENT) / calibration.DOUBT)
                 for half in (1 - parts.high, parts.high))  # fmt: skip
    least = min(low, high)
    return np.array([least + (high - least) * share for share in parts.high])


@pytest.mark.parametrize("negatives", [("sky", "Wall"), ()])
def test_a_thing_by_its_parts(temperature, negatives):
    query = asked(temperature, ("swan", "boat", *negatives), 2)
    rivals = [WORDS[word] for word in negatives]
    expected = np.maximum(*(thing(WORDS[word], rivals, temperature or 0.07) for word in ("swan", "boat")))
    np.testing.assert_allclose(word_probabilities(scene_with(["swan"]), query), expected[INDEX], atol=1e-9)


def test_a_surface_is_present_by_evidence_like_everything(temperature):
    """A teacher of things would rather call a dark pond grass than water; what is there decides, not which is likelier."""
    used = temperature or 0.07
    surfaces = asked(temperature, BACKGROUND, 1)
    expected = thing(surfaces.vectors[0], surfaces.vectors[1:], used)[INDEX]
    np.testing.assert_allclose(word_probabilities(scene_with(["Wall"]), surfaces), expected, atol=1e-9)


def test_no_null_vector_no_probability(temperature):
    query = asked(temperature, ("swan", "sky"), 1)
    query.head.spec.text_encoder = "others"
    assert word_probabilities(scene_with(["swan"]), query) is None
