"""Words that may have been found by chance are not told as certain, and what stands still is no event."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import LABELS, VECTORS, labelled_scene

from f4x_core.api import ask
from f4x_core.query import calibration, inventory
from f4x_core.query.inventory import instead, is_doubtful, things_there
from f4x_core.query.selection import Selection
from f4x_core.scene.field import FeatureField, Vocabulary, quantise

NULL = np.float32([0.5, 0.5, 0.5, 0.5, 0, 0, 0, 0])
FAR, NEAR = 1.0, 0.32
"""How far latents lie from `NULL` towards their word: all the way, and where it is there with a probability of about .8."""


@pytest.fixture(autouse=True)
def null(monkeypatch):
    """The toy's text encoder has a null vector, so scores are probabilities."""
    for module in (calibration, inventory):
        monkeypatch.setattr(module, "null_vector", lambda encoder: NULL)


def scene_of(square=FAR, wall=FAR, labels=LABELS, vectors=VECTORS):
    """The labelled scene with so clear latents of its two things, and these words."""
    plain = labelled_scene()
    field = plain.features
    own = [NULL + clear * (vector - NULL) for clear, vector in ((wall, VECTORS[1]), (square, VECTORS[0]))]
    latents = [
        np.tile(one / np.linalg.norm(one), (count, 1)) for one, count in zip(own, (len(plain.static), 4), strict=True)
    ]
    parts = quantise(*(one.astype(np.float32) for one in latents))
    words = {"words": Vocabulary(labels, vectors.astype(np.float16))}
    return replace(plain, features=FeatureField(*parts, field.heads, words))


def test_of_many_words_that_are_tried_some_are_there_by_chance(monkeypatch):
    scene = scene_of()
    nobody = np.zeros(len(scene.ids), bool)
    for best, doubtful in ((0.85, True), (0.9, False)):  # times four words
        assert is_doubtful(scene, Selection(scene.ids, np.full(len(nobody), best), nobody)) is doubtful
    monkeypatch.setattr(inventory, "null_vector", lambda encoder: None)  # whose scores say which word, not whether one
    assert not is_doubtful(scene, Selection(scene.ids, np.full(len(nobody), 0.1), nobody))


def test_a_doubtful_word_is_not_told_as_certain():
    scene = scene_of(wall=NEAR)
    assert 0.6 < things_there(scene)["wall"].scores.max() < 0.87
    text = ask(scene, "What do you see?").text
    assert "what may be a wall: " in text and "What may be a wall stands still" in text and "the wall" not in text
    assert "square: " in text and "The square moves" in text
    assert ask(scene, "Does the wall move?").text.startswith(
        "No: the wall stands still"
    )  # who asks for it has said the word
    assert "the wall: " not in ask(scene, "What is biggest?").text
    assert "what may be a wall" in ask(scene, "What stands still?").text
    assert "The biggest thing is the square" in ask(scene, "What is biggest except the wall?").text


def test_what_stands_still_is_no_event():
    scene = scene_of()
    assert "The wall stands still" in ask(scene, "What do you see?").text
    for question in ("What happens?", "what is going on here", "describe what happens"):
        text = ask(scene, question).text
        assert "wall" not in text and "The square moves" in text
    still = replace(scene, dynamic=type(scene.dynamic).empty(), scaffold=None, features=None)
    assert ask(still, "What happens?").text.startswith("Nothing moves.")


def test_refusals_offer_what_is_surely_there():
    assert instead(scene_of(), ["zebra"])[1] in (
        "the scene answers to wall, square",
        "the scene answers to square, wall",
    )
    assert instead(scene_of(wall=NEAR), ["zebra"]) == (["square"], "the scene answers to square")
    labels, told = instead(scene_of(NEAR, NEAR), ["zebra"])
    assert sorted(labels) == ["square", "wall"] and told.startswith("the scene answers, but weakly, to ")


def test_a_narrower_word_that_is_accepted_is_offered_with_the_broader_one():
    labels = ("bird", "fence", "swan", "goose")
    vectors = VECTORS.copy()
    vectors[2] = (VECTORS[0] + 0.4 * np.eye(8)[4]) / np.hypot(1, 0.4)
    scene = scene_of(labels=labels, vectors=vectors)
    assert "swan" not in things_there(scene)
    assert instead(scene, ["zebra"])[0] == ["fence", "bird", "swan"]
    vectors[2] = VECTORS[2]  # nothing there answers to it
    assert "swan" not in instead(scene_of(labels=labels, vectors=vectors), ["zebra"])[0]
