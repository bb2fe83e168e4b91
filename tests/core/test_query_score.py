"""Scores, the selection rule, and selections with their algebra and their file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.errors import F4xError
from f4x_core.query.score import average_precision, cosines, overlap, select, target_score, text_scores
from f4x_core.query.selection import Selection, fingerprint


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


def test_cosines_of_short_vectors_and_of_none():
    rng = np.random.default_rng(1)
    features, labels = 0.05 * rng.normal(size=(4, 3, 5)), 0.02 * rng.normal(size=(6, 5))
    features[1, 2] = 0
    found = cosines(features, labels)
    for i, j, k in np.ndindex(4, 3, 6):
        length = np.linalg.norm(features[i, j]) * np.linalg.norm(labels[k])
        assert found[i, j, k] == pytest.approx(features[i, j] @ labels[k] / length if length else 0)
    assert not found[1, 2].any()


def test_the_common_temperature_and_one_label():
    features, labels = np.random.default_rng(2).normal(size=(7, 4)), np.eye(2, 4)
    np.testing.assert_array_equal(text_scores(features, labels), text_scores(features, labels, 0.07))
    np.testing.assert_array_equal(text_scores(features, labels[:1], 1e-3), np.ones((7, 1)))
    for temperature in (-1, 0):
        with pytest.raises(F4xError, match="temperature"):
            text_scores(features, labels, temperature)
    assert text_scores(features, labels, 1.0).max() < 1


def test_targets_on_pictures_count_once():
    scores = np.random.default_rng(3).dirichlet(np.ones(4), (3, 5))
    total, best = target_score(scores, [1, 3, 1])
    np.testing.assert_allclose(total, scores[..., 1] + scores[..., 3])
    np.testing.assert_array_equal(best, (scores.argmax(-1) == 1) | (scores.argmax(-1) == 3))
    for target in (2, [2]):
        np.testing.assert_array_equal(select(scores, target), (scores[..., 2] >= 0.5) | (scores.argmax(-1) == 2))


def test_average_precision_by_counting():
    """The mean over true ones of the precision among all that score as high."""
    rng = np.random.default_rng(4)
    for levels in (3, 50):
        scores, truth = rng.integers(0, levels, (6, 5)) / levels, rng.random((6, 5)) < 0.4
        expected = [truth[scores >= score].mean() for score in scores[truth]]
        assert average_precision(scores, truth) == pytest.approx(np.mean(expected))
    assert average_precision(np.array([0.9, 0.8, 0.7]), np.array([False, False, True])) == pytest.approx(1 / 3)
    assert average_precision(np.array([0.5]), np.array([True])) == 1
    assert np.isnan(average_precision(np.zeros(0), np.zeros(0, bool)))


def test_overlap_of_nothing_and_of_apart():
    none, some = np.zeros(3, bool), np.array([True, False, True])
    assert overlap(none, none) == 1 and overlap(some, none) == 0 and overlap(some, some) == 1


def test_what_no_selection_can_be():
    ids, scores, wins = np.arange(3), np.ones(3), np.zeros(3, bool)
    for threshold in (0, 0.5, 1):
        assert Selection(ids, scores, wins, threshold, (2, 2)).threshold == threshold
    for threshold in (-0.01, 1.01, float("nan")):
        with pytest.raises(F4xError, match="no fraction"):
            Selection(ids, scores, wins, threshold)
    for parts in ((ids[:2], scores, wins), (ids, scores[:2], wins), (ids, scores, wins[:2])):
        with pytest.raises(F4xError, match="one score for each id"):
            Selection(*parts)


def test_a_selection_holds_from_its_first_frame_to_its_last():
    a = random_selection(1).within(2, 5)
    assert [a.holds_at(time) for time in (1.9, 2, 3, 5, 5.1)] == [False, True, True, True, False]


def test_among_takes_scores_and_wins():
    a = random_selection(1)
    rows = np.arange(200) % 3 == 0
    found = a.among(rows)
    np.testing.assert_array_equal(found.scores, np.where(rows, a.scores, 0))
    np.testing.assert_array_equal(found.wins, a.wins & rows)
    assert a.wins[~rows].any() and a.wins[rows].any()


def test_a_selection_belongs_to_the_scene_it_was_made_of():
    """Of a scene's name; without one, of the ids."""
    scene = labelled_scene(features=False)
    count = len(scene.ids)
    own = Selection(scene.ids, np.ones(count), np.zeros(count, bool), scene=fingerprint(scene))
    own.require_scene(scene)
    replace(own, ids=own.ids + 5).require_scene(scene)  # copies that were undone may lack
    nameless = replace(own, scene="")
    nameless.require_scene(scene)
    for other in (replace(own, scene="dog 0"), replace(nameless, ids=own.ids + 5)):
        with pytest.raises(F4xError, match="made"):
            other.require_scene(scene)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_rows_follow_the_ids(count):
    """Ids out of order, some asked for that are not there, below, between and above."""
    ids = np.array([40, 10, 30, 20, 50])[:count]
    some = Selection(ids, np.arange(1.0, count + 1) / 10, np.arange(count) % 2 == 0)
    asked = np.array([50, 5, 10, 35, 40, 99, 20, 30])
    found = some.for_ids(asked)
    scores = {int(id): (score, win) for id, score, win in zip(ids, some.scores, some.wins, strict=True)}
    assert found.ids.tolist() == asked.tolist()
    assert found.scores.tolist() == [scores.get(id, (0, False))[0] for id in asked.tolist()]
    assert found.wins.tolist() == [scores.get(id, (0, False))[1] for id in asked.tolist()]


def test_scores_of_combinations():
    """The other's scores are stretched so that its threshold falls on the own one; then the smaller or larger counts."""
    none = np.zeros(4, bool)
    a = Selection(np.arange(4), np.array([0.1, 0.3, 0.5, 0.9]), none, 0.4)
    b = Selection(np.arange(4), np.array([0.4, 0.9, 0.8, 0.0]), none, 0.8)
    moved = np.array([0.2, 0.7, 0.4, 0.0])  # 0.4 is half of 0.8, so half of 0.4; 0.9 is half way from 0.8 to 1
    np.testing.assert_allclose((a & b).scores, np.minimum(a.scores, moved))
    np.testing.assert_allclose((a | b).scores, np.maximum(a.scores, moved))
    np.testing.assert_allclose((~a).scores, 1 - a.scores)
    assert (a & b).threshold == (a | b).threshold == 0.4 and (~b).threshold == pytest.approx(0.2)


def test_who_wins_or_is_on_the_threshold_stays_on_its_side():
    ids, scores = np.arange(3), np.array([0.5, 0.2, 0.5])
    a = Selection(ids, scores, np.array([False, True, False]), 0.5)
    b = Selection(ids, np.array([0.5, 0.9, 0.1]), np.zeros(3, bool), 0.5)
    both = a & b
    assert both.scores[1] == 0.5 and not both.wins.any() and both.scores[2] == 0.1
    turned = ~a
    assert turned.scores.tolist() == [np.nextafter(0.5, 0), np.nextafter(0.5, 0), np.nextafter(0.5, 0)]
    assert (~Selection(ids, scores, np.zeros(3, bool), 1.0)).threshold == 1e-6


def test_spans_of_combinations():
    a, always = random_selection(1).within(2, 6), random_selection(2)
    assert (a & always).span == (always & a).span == (2, 6) and (always & always).span is None
    assert (a | always).span is None and (always | a).span is None
    assert (a & always.within(6, 7)).span == (6, 6)
    assert (a & always.within(3, 4)).span == (3, 4) and (a | always.within(3, 4)).span == (2, 6)
    assert (a | always.within(0, 1)).span == (0, 6) and (a | always.within(8, 9)).span == (2, 9)


def test_the_numbers_of_a_file():
    """Rounded to four digits, up for those that are chosen, down for others; nobody without a score."""
    scores = np.array([0.50001, 0.49999, 0.12345, 0.00004, 1.0, 0.0, 0.00012])
    wins = np.array([False, False, True, False, False, True, False])
    data = Selection(10 + np.arange(7), scores, wins, 0.5, (1, 2)).to_json()
    assert data["ids"] == [10, 11, 12, 14, 15, 16] and data["wins"] == [12, 15] and data["count"] == 4
    assert data["scores"] == pytest.approx([0.5001, 0.4999, 0.1234, 1, 0, 0.0001], abs=1e-12)
    assert data["span"] == [1, 2] and data["threshold"] == 0.5
    on_it = Selection(np.arange(2), np.array([0.12345, 0.12344]), wins[:2], 0.12345).to_json()
    assert on_it["scores"] == pytest.approx([0.1235, 0.1234], abs=1e-12)  # who is just chosen stays so
    again = Selection.from_json(data)
    assert again.span == (1, 2) and again.ids[again.wins].tolist() == [12, 15]
    assert Selection.from_json(random_selection(1).to_json()).span is None
