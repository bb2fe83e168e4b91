"""Scores, the selection rule, and selections with their algebra and their file."""

import json

import numpy as np
import pytest

from f4x_core.errors import F4xError
from f4x_core.query.score import average_precision, overlap, select, text_scores
from f4x_core.query.selection import Selection


def random_selection(seed, threshold=0.5, count=200):
    rng = np.random.default_rng(seed)
    return Selection(np.arange(count), rng.random(count), rng.random(count) < 0.1, threshold, None, f"s{seed}")


def test_text_scores_are_the_softmax_of_cosines():
    rng = np.random.default_rng(0)
    features, labels = rng.normal(size=(5, 7, 3)), rng.normal(size=(4, 3))
    cosine = np.array(
        [[[f @ w / np.linalg.norm(f) / np.linalg.norm(w) for w in labels] for f in row] for row in features]
    )
    expected = np.exp(cosine / 0.2) / np.exp(cosine / 0.2).sum(-1, keepdims=True)
    np.testing.assert_allclose(text_scores(features, labels, 0.2), expected, atol=1e-12)
    np.testing.assert_allclose(text_scores(9 * features, labels, 0.2), expected, atol=1e-12)


def test_a_temperature_turns_flat_cosines_into_a_majority():
    """Five labels, cosine 1 against -1: without a temperature the best possible score is e / (e + 4/e) = 0.65."""
    labels = np.array([[1.0], [-1], [-1], [-1], [-1]])
    assert text_scores(np.ones(1), labels, 1.0)[0] == pytest.approx(np.e / (np.e + 4 / np.e))
    assert text_scores(np.ones(1), labels, 0.07)[0] > 0.999


def test_the_rule_is_threshold_or_argmax():
    scores = np.array([[0.4, 0.35, 0.25], [0.3, 0.45, 0.25], [0.35, 0.25, 0.4]])
    np.testing.assert_array_equal(select(scores, 0, 0.5), [True, False, False])
    np.testing.assert_array_equal(select(scores, 0, 0.35), [True, False, True])
    np.testing.assert_array_equal(select(scores, [0, 2], 0.6), [True, False, True])


@pytest.mark.parametrize(
    ("features", "labels", "temperature", "words"),
    [(np.ones(3), np.zeros((0, 3)), 0.1, "no labels"), (np.ones(3), np.ones((2, 4)), 0.1, "3 channels"),
     (np.ones(3), np.ones((2, 3)), 0.0, "temperature")],
)  # fmt: skip
def test_scores_refuse(features, labels, temperature, words):
    with pytest.raises(F4xError, match=words):
        text_scores(features, labels, temperature)


def test_average_precision_of_known_orders():
    truth = np.array([True, False, True, False])
    assert average_precision(np.array([4.0, 3, 2, 1]), truth) == pytest.approx((1 + 2 / 3) / 2)
    assert average_precision(np.array([4.0, 1, 3, 2]), truth) == 1
    assert average_precision(np.ones(4), truth) == 0.5  # ties: chance, however the pixels lie
    assert np.isnan(average_precision(np.ones(2), np.zeros(2, bool)))
    assert overlap(np.array([True, True, False]), np.array([False, True, True])) == pytest.approx(1 / 3)


@pytest.mark.parametrize("other", [0.5, 0.2, 0.9])
def test_and_or_not_choose_as_sets(other):
    a, b = random_selection(1), random_selection(2, other)
    np.testing.assert_array_equal((a & b).chosen, a.chosen & b.chosen)
    np.testing.assert_array_equal((a | b).chosen, a.chosen | b.chosen)
    np.testing.assert_array_equal((~b).chosen, ~b.chosen)
    np.testing.assert_array_equal((~~b).chosen, b.chosen)
    for combined in (a & b, a | b, ~a):
        assert combined.scores.min() >= 0 and combined.scores.max() <= 1


@pytest.mark.parametrize("threshold", [0.0, 1.0])
def test_not_at_the_ends_of_the_scale(threshold):
    a = random_selection(3, threshold)
    np.testing.assert_array_equal((~a).chosen, ~a.chosen)


def test_combining_goes_by_id_not_by_row():
    a = random_selection(1)
    order = np.random.default_rng(5).permutation(len(a.ids))
    shuffled = Selection(a.ids[order], a.scores[order], a.wins[order], a.threshold)
    np.testing.assert_array_equal((a & shuffled).chosen, a.chosen)
    fewer = Selection(a.ids[:10], a.scores[:10], a.wins[:10], a.threshold)
    assert not (a & fewer).chosen[10:].any()


def test_rethresholding_needs_no_new_query():
    a = random_selection(4)
    assert a.at_threshold(0.9).chosen.sum() < a.chosen.sum()
    np.testing.assert_array_equal(a.at_threshold(0.9).chosen, (a.scores >= 0.9) | a.wins)
    np.testing.assert_array_equal(a.at_threshold(0.9, keep_wins=False).chosen, a.scores >= 0.9)


def test_spans():
    a, b = random_selection(1).within(0, 4), random_selection(2).within(3, 8)
    assert (a & b).span == (3, 4) and (a | b).span == (0, 8) and (a | random_selection(3)).span is None
    assert a.holds_at(4) and not a.holds_at(4.5) and random_selection(3).holds_at(99)
    with pytest.raises(F4xError, match="overlap"):
        a & random_selection(2).within(6, 8)
    with pytest.raises(F4xError, match="ends before"):
        a.within(3, 2)


@pytest.mark.parametrize("threshold", [0.5, 1 / 3, 0.00004, 1.0])
def test_json_keeps_who_is_chosen(threshold):
    a = random_selection(7, threshold).within(1, 3)
    b = Selection.from_json(json.loads(json.dumps(a.to_json()))).for_ids(a.ids)
    np.testing.assert_array_equal(b.chosen, a.chosen)
    np.testing.assert_array_equal(b.wins, a.wins)
    np.testing.assert_allclose(b.scores, a.scores, atol=1e-4)
    assert (b.threshold, b.span, b.label) == (a.threshold, a.span, a.label)


@pytest.mark.parametrize("data", [None, [], {"format": "f4x-selection"}, {"format": "x"}])
def test_foreign_json_is_refused(data):
    with pytest.raises(F4xError, match="selection"):
        Selection.from_json(data)


def test_damaged_json_is_refused():
    good = random_selection(1).to_json()
    for name, value in (("scores", [1]), ("ids", ["a"]), ("span", [1]), ("threshold", 2), ("wins", None)):
        with pytest.raises(F4xError):
            Selection.from_json(good | {name: value})
