"""Words that select: votes of neighbours, the split at the scene's gap, presence, surfaces, leakage, true labels."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import HEIGHT, VECTORS, WIDTH, field, labelled_scene, square_mask

from benchmarks.quality import labels as truth_labels
from f4x_core.evaluation.truth import SeenSurface
from f4x_core.features.null import null_vector
from f4x_core.geometry.camera import Camera
from f4x_core.query import calibration, smoothing
from f4x_core.query.calibration import evidence, split
from f4x_core.query.labels import BACKGROUND, ask_for
from f4x_core.query.leakage import largest_region, leakage
from f4x_core.query.pixels import label_scores
from f4x_core.query.prompts import SelectOptions, select_by_text
from f4x_core.query.score import select
from f4x_core.query.selection import Selection
from f4x_core.query.smoothing import group, group_of
from f4x_core.scene.field import quantise

NULL = np.float32([0.5, 0.5, 0.5, 0.5, 0, 0, 0, 0])
"""Of the toy's words: what a label's vector shows of another is then no evidence."""


@pytest.fixture
def scene(monkeypatch):
    """The labelled scene, whose text encoder has a null vector."""
    monkeypatch.setattr(calibration, "null_vector", lambda encoder: NULL)
    return labelled_scene()


def is_square(scene):
    return np.arange(len(scene.ids)) >= len(scene.static)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def elephant(encoder, words):
    """An encoder that knows one word, which nothing in the scene looks like."""
    assert words == ["elephant"]
    return VECTORS[2:3]


def test_smoothing_solves_its_linear_system(monkeypatch):
    monkeypatch.setattr(smoothing, "TOLERANCE", 1e-12)
    monkeypatch.setattr(smoothing, "STEPS", 2000)
    patches = group(labelled_scene())
    values = np.random.default_rng(0).normal(size=len(patches.weight))
    rows = np.repeat(np.arange(len(values)), np.diff(np.append(patches.first, len(patches.bond))))
    bonds = np.zeros((len(values), len(values)))
    np.add.at(bonds, (rows, patches.other), patches.bond.astype(float))
    np.testing.assert_array_equal(bonds, bonds.T)
    own = 0.04 * np.minimum(patches.weight, np.quantile(patches.weight, smoothing.MAX_WEIGHT_QUANTILE))
    own += 1e-6 * own.mean()
    expected = np.linalg.solve(np.diag(own + bonds.sum(1)) - bonds, own * values)
    np.testing.assert_allclose(patches.smooth(values, 0.04), expected, atol=1e-5)
    constant = np.full(len(values), 3.0)
    np.testing.assert_allclose(patches.smooth(constant), constant, atol=1e-4)


def test_patches_are_neighbours_of_one_kind():
    scene = labelled_scene()
    patches = group(scene)
    moving = np.bincount(patches.index, is_square(scene)) / np.bincount(patches.index)
    assert set(moving) == {0.0, 1.0}
    x = scene.posed(3.0).means
    for patch in range(len(patches.weight)):
        assert np.ptp(x[patches.index == patch], axis=0).max() < 2 * smoothing.CELL * WIDTH / 60 * 1.2
    assert patches.weight.mean() == pytest.approx(1)
    assert group_of(scene) is group_of(scene)


def test_a_speckle_is_outvoted_and_an_edge_is_not(scene):
    """A fifth of the wall's words are wrong, its looks are not: channels 0 to 3 are words, 4 to 7 looks."""
    looks = np.roll(VECTORS, 4, axis=1)
    speckled = np.random.default_rng(1).random(len(scene.static)) < 0.2
    static = np.where(speckled[:, None], VECTORS[0], VECTORS[1]) + looks[1]
    nodes = np.tile(VECTORS[0] + looks[0], (4, 1))
    parts = np.diag([1, 1, 1, 1, 0, 0, 0, 0]).astype(np.float16), np.diag([0, 0, 0, 0, 1, 1, 1, 1]).astype(np.float16)
    heads = tuple(replace(head, weights=(part,)) for head, part in zip(scene.features.heads, parts, strict=True))
    static, nodes, low, step = quantise(static.astype(np.float32), nodes)
    field = replace(scene.features, static=static, nodes=nodes, low=low, step=step, heads=heads)
    noisy = replace(scene, features=field)
    assert (
        select_by_text(noisy, ["square"], options=SelectOptions(calibrated=False)).chosen[: len(static)].mean() > 0.15
    )
    np.testing.assert_array_equal(select_by_text(noisy, ["square"]).chosen, is_square(scene))


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.9])
def test_the_split_finds_two_normal_distributions(share):
    rng = np.random.default_rng(2)
    high = rng.random(4000) < share
    values = np.where(high, rng.normal(1.5, 0.5, 4000), rng.normal(-1, 0.3, 4000))
    found = split(values, np.ones(4000))
    assert found.means == (pytest.approx(-1, abs=0.1), pytest.approx(1.5, abs=0.1))
    assert found.fraction == pytest.approx(share, abs=0.02)
    assert ((found.high > 0.5) == high).mean() > 0.98
    steps = np.diff(found.high[np.argsort(values)])
    assert steps.min() > -1e-9  # a higher score is never less probable


def test_the_split_ends_where_more_rounds_change_nothing(monkeypatch):
    random = np.random.default_rng(3)
    values = np.concatenate([random.normal(0, 1, 3000), random.normal(4, 0.7, 500)])
    weights = random.random(3500)
    rounds = []
    monkeypatch.setattr(calibration, "logistic", lambda odds: rounds.append(0) or 1 / (1 + np.exp(-odds)))
    early, used = split(values, weights), len(rounds)
    assert used < calibration.ROUNDS / 2
    monkeypatch.setattr(calibration, "SETTLED", 0.0)
    monkeypatch.setattr(calibration, "ROUNDS", 2000)
    np.testing.assert_allclose(early.high, split(values, weights).high, atol=1e-6)


def test_the_split_weighs_and_survives_a_constant():
    values, weights = np.array([0.0, 0.1, 5.0, 5.1]), np.array([1.0, 1, 3, 3])
    assert split(values, weights).fraction == pytest.approx(0.75)
    assert np.isfinite(split(np.ones(5), np.ones(5)).high).all()
    assert np.isfinite(split(np.ones(1), np.ones(1)).high).all()


def test_evidence_is_the_way_from_the_null():
    rng = np.random.default_rng(3)
    null, label, features = (unit(rng.normal(size=shape)) for shape in (6, (1, 6), (4, 6)))
    expected = [(f - null) @ (label[0] - null) / np.linalg.norm(label[0] - null) for f in features]
    np.testing.assert_allclose(evidence(5 * features, 2 * label, null)[:, 0], expected)
    assert evidence(null[None], label, null)[0, 0] == pytest.approx(0)


def test_a_thing_that_is_there(scene):
    found = select_by_text(scene, ["square"])
    np.testing.assert_array_equal(found.chosen, is_square(scene))
    assert not found.wins.any() and found.scores.min() >= 0 and found.scores.max() <= 1
    fewer = found.at_threshold(0.99)
    assert (fewer.chosen <= found.chosen).all() and found.at_threshold(0).chosen.all()


def test_a_thing_that_is_absent_or_everywhere(scene):
    assert not select_by_text(scene, ["elephant"], encode=elephant).chosen.any()
    everywhere = replace(scene, features=field(len(scene.static), 4))
    static = np.tile(everywhere.features.nodes[:1], (len(scene.static), 1))
    everywhere = replace(scene, features=replace(everywhere.features, static=static))
    assert select_by_text(everywhere, ["square"]).chosen.all()
    both = select_by_text(scene, ["square", "elephant"], encode=elephant)
    np.testing.assert_array_equal(both.chosen, is_square(scene))


def test_patches_are_decoded_once_for_all_words(scene, monkeypatch):
    calibration.prepare(scene)
    patches = group_of(scene)
    (head,) = patches._decoded
    assert head.spec.text_encoder is not None and len(scene.features.heads) > 1
    np.testing.assert_array_equal(patches.features(head), head(patches.latents))

    def decoded_again(head, latent):
        raise AssertionError("decoded again")

    monkeypatch.setattr(type(head), "__call__", decoded_again)
    np.testing.assert_array_equal(select_by_text(scene, ["square"]).chosen, is_square(scene))
    twice = replace(scene, static=scene.static)
    assert group_of(twice).features(head) is patches.features(head)


def test_a_surface_is_found_by_what_speaks_for_it_alone(scene):
    assert {"wall", "sky", "grass"} <= set(BACKGROUND)
    np.testing.assert_array_equal(select_by_text(scene, ["wall"]).chosen, ~is_square(scene))
    assert not select_by_text(scene, ["sky", "grass"]).chosen.any()


def test_the_rule_of_feature4x_stays(scene):
    query = ask_for(scene, ["square"])
    expected = select(label_scores(query, scene.latents()), 0)
    np.testing.assert_array_equal(
        select_by_text(scene, ["square"], options=SelectOptions(calibrated=False)).chosen, expected
    )


def test_without_a_null_vector_the_rule_decides():
    scene = labelled_scene()
    assert null_vector("words") is None
    with_rule, default = (
        select_by_text(scene, ["square"], options=SelectOptions(calibrated=kind)) for kind in (False, True)
    )
    np.testing.assert_array_equal(with_rule.scores, default.scores)
    assert default.wins.any()


def test_the_null_vector_is_a_unit_vector():
    assert null_vector("minilm").shape == (384,)
    assert np.linalg.norm(null_vector("minilm")) == pytest.approx(1, abs=1e-3)


@pytest.mark.real
def test_the_null_vector_is_the_mean_of_the_classes():
    offline = pytest.importorskip("f4x_core.features.offline")
    mean = offline.class_embeddings(offline.MiniLm().encode).mean(0)
    np.testing.assert_allclose(null_vector("minilm"), mean / np.linalg.norm(mean), atol=1e-3)


def test_leakage_is_light_outside(scene):
    found = select_by_text(scene, ["square"])
    masks = {t: square_mask(float(t)) for t in (0, 3)}
    assert leakage(scene, found, masks) < 0.1
    assert leakage(scene, found, {t: ~mask for t, mask in masks.items()}) > 0.9
    assert leakage(scene, found) < 0.1
    nobody = Selection(found.ids, np.zeros(len(found.ids)), np.zeros(len(found.ids), bool))
    assert leakage(scene, nobody, masks) == 0
    assert leakage(scene, found.within(3, 3), {0: ~masks[0], 3: masks[3]}) < 0.1


def test_the_largest_region():
    mask = np.zeros((5, 8), bool)
    mask[0, :2] = mask[2:4, 4:8] = True
    np.testing.assert_array_equal(np.argwhere(largest_region(mask)).min(0), [2, 4])
    assert largest_region(mask).sum() == 8 and not largest_region(mask & False).any()


def test_true_labels_of_the_original_views(scene, monkeypatch, tmp_path):
    clip = truth_labels.TrueClip(tmp_path, scene.cameras, [7], [], np.arange(6), None, 1.0, False)
    monkeypatch.setattr(truth_labels.TrueClip, "read", classmethod(lambda cls, scene, folder: clip))

    def passes(file):
        depth = np.full((HEIGHT, WIDTH), 1.2, np.float32)
        return {"Object Index": np.where(square_mask(float(int(file.stem))), 7.0, 3.0), "Depth": depth}

    monkeypatch.setattr(truth_labels, "read_passes", passes)
    monkeypatch.setattr(SeenSurface, "read", classmethod(lambda cls, *rest: cls(np.zeros((1, 3)), {})))
    scores = truth_labels.score_labels(scene, tmp_path, "square", ["wall"])
    assert scores["selection_accuracy_original"] > 0.99 and scores["selection_miou_original"] > 0.98
    assert scores["argmax_miou_original"] > 0.98 and scores["selection_ap_original"] > 0.99
    assert "selection_miou_novel" not in scores


def test_the_subject_seen_from_elsewhere():
    """A square at depth 1 before a plane at depth 2: from half a unit to the right it covers what lies further left."""
    wall = np.stack([*np.meshgrid(np.linspace(-3, 3, 400), np.linspace(-2, 2, 300)), np.full((300, 400), 2.0)], -1)
    side = np.linspace(-0.2, 0.2, 60)
    square = np.stack([*np.meshgrid(side, side), np.full((60, 60), 1.0)], -1).reshape(-1, 3)
    seen = SeenSurface(wall.reshape(-1, 3), {4: square})
    world_to_camera = np.eye(4)
    world_to_camera[0, 3] = -0.5
    camera = Camera(np.array([[50.0, 0, 40], [0, 50, 30], [0, 0, 1]]), world_to_camera, 80, 60)
    subject, known = truth_labels.subject_from(seen, camera, 4)
    expected = np.zeros((60, 80), bool)
    expected[20:40, 5:25] = True  # x = 40 + 50 (-0.5 +- 0.2)
    assert (subject != expected).mean() < 0.01 and known.all()
