"""What a teacher does not know is refused in one sentence, everywhere; answers that are another label's name it."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.edit.naming import by_words
from f4x_core.edit.resolve import EditorState, Resolver
from f4x_core.edit.selects import Text
from f4x_core.errors import F4xError
from f4x_core.features.unknown import UNKNOWN, unknown_kind
from f4x_core.query import knowledge
from f4x_core.query.inventory import instead, mean_the_same, nearest_labels, things_there
from f4x_core.query.knowledge import refuse_evidence_of_another, refuse_unknown
from f4x_core.query.selection import Selection
from f4x_core.scene import Vocabulary

from .labelled_scene import labelled_scene


@pytest.fixture
def scene(monkeypatch):
    monkeypatch.setitem(UNKNOWN, "words", UNKNOWN["minilm"])
    return labelled_scene()


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        ("rider", "people"),
        ("the horse rider", "people"),
        ("Dancers", "people"),
        ("policeman", "people"),
        ("pavement", "surfaces"),
        ("lawn", "surfaces"),
        ("the water", "surfaces"),
        ("road", "surfaces"),
        ("the dirt road", "surfaces"),
        ("man in a red car", "people"),
        ("apple trees", "plants"),
        ("sky", "sky"),
        ("cartoon dog", "drawn things"),
        ("drawing of a swan", "drawn things"),
        ("logo", "drawn things"),
        *(
            (label, None)
            for label in (
                "square",
                "dog",
                "tiger",
                "flower",
                "dog on the grass",
                "toy soldier",
                "shoe tree",
                "wall",
                "waterfowl",
                "traffic light",
                "park bench",
                "human-sized box",
                "tower",
                "van",
            )
        ),
    ],
)
def test_kinds_that_a_teacher_of_photographed_things_does_not_know(label, kind):
    assert unknown_kind("minilm", label) == kind


def test_they_are_refused_in_the_same_sentence_by_words_and_in_sentences(scene):
    said = []
    for ask in (
        lambda: refuse_unknown(scene, "rider"),
        lambda: by_words(scene, ["square", "rider"]),
        lambda: Resolver(EditorState()).select(scene, Text(("rider",))),
    ):
        with pytest.raises(F4xError) as error:
            ask()
        said.append(str(error.value))
    assert len(set(said)) == 1
    assert "knows no people; click on the thing or draw a box" in said[0] and "; the scene answers to " in said[0]
    refuse_unknown(scene, "square")
    assert by_words(scene, ["square"])["square"].chosen.any()


def test_labels_are_called_near_where_they_are():
    labels = ("square", "wall", *(f"thing {i}" for i in range(30)))
    vectors = np.zeros((len(labels), 8), np.float32)
    vectors[2:, 2:] = np.random.default_rng(0).normal(size=(30, 6))
    vectors[0, 0] = vectors[1, 1] = 1
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    scene = labelled_scene()
    field = replace(scene.require_field(), vocabularies={"words": Vocabulary(labels, vectors.astype(np.float16))})
    scene = replace(scene, features=field)
    meanings = {"rhomb": vectors[0], "barrier": vectors[1], "music": vectors[9], "sqaure": vectors[9]}

    def near(words, there=labels):
        return nearest_labels(scene, words, there, lambda encoder, asked: np.stack([meanings[word] for word in asked]))

    assert near(["rhomb"]) == ["square"]
    assert near(["rhomb", "barrier"], labels[:2]) == ["square", "wall"]
    assert near(["music"], labels[:2]) == []
    assert near(["sqaure"], labels[:2]) == ["square"]  # by its letters
    assert near(["rhomb"], labels[1:2]) == []
    with pytest.raises(F4xError, match="lacks 'rhomb'"):
        nearest_labels(scene, ["rhomb"], labels)


def test_without_a_vector_only_spelling_is_near(scene):
    assert instead(scene, ["sqaure"]) == (["square"], "nearest labels: square")
    labels, message = instead(scene, ["zebra"])
    assert sorted(labels) == ["square", "wall"] and message == f"the scene answers to {', '.join(labels)}"


def test_other_teachers_are_not_asked_what_they_know():
    assert unknown_kind("words", "rider") is None
    refuse_unknown(labelled_scene(), "rider")


def test_what_is_cast_needs_no_teacher(scene):
    refuse_unknown(scene, "the rider's shadow")


def test_what_the_teacher_does_not_know_is_not_said_to_be_there(monkeypatch):
    assert "wall" in things_there(labelled_scene())
    monkeypatch.setitem(UNKNOWN, "words", {"surfaces": "walls?"})
    assert [*things_there(labelled_scene())] == ["square"]


def test_an_answer_that_is_another_labels_names_it(scene, monkeypatch):
    """Evidence here is the cosine itself: of what moves it is 1 for "square", and that of the angle for "rhomb"."""
    monkeypatch.setattr(knowledge, "null_vector", lambda encoder: np.zeros(8))
    moves = Selection(scene.ids, scene.moving.astype(float), np.zeros(len(scene.ids), bool))

    def encode(cosine):
        return lambda name, labels: np.array([[cosine, 0, 0, np.sqrt(1 - cosine**2), 0, 0, 0, 0]])

    with pytest.raises(F4xError, match=r"answers more to 'square' \(1.00 against 0.59\)"):
        refuse_evidence_of_another(scene, "rhomb", moves, encode(0.59))
    refuse_evidence_of_another(scene, "rhomb", moves, encode(0.61))  # a word for the same thing
    refuse_evidence_of_another(scene, "square", moves)
    monkeypatch.setattr(knowledge, "ALIKE", 0.99)  # no more a word for the same thing: a twentieth of evidence decides
    refuse_evidence_of_another(scene, "rhomb", moves, encode(0.96))
    with pytest.raises(F4xError, match=r"answers more to 'square' \(1.00 against 0.94\)"):
        refuse_evidence_of_another(scene, "rhomb", moves, encode(0.94))
    nobody = Selection(scene.ids, np.zeros(len(scene.ids)), np.zeros(len(scene.ids), bool))
    refuse_evidence_of_another(scene, "rhomb", nobody, encode(0.59))


def test_an_edit_is_refused_what_a_query_is(scene, monkeypatch):
    """ "Remove the unicorn" once removed the horse that a query for a unicorn asks about."""
    monkeypatch.setattr(knowledge, "null_vector", lambda encoder: np.zeros(8))
    near = Resolver(EditorState(), lambda name, labels: np.array([[0.59, 0, 0, np.sqrt(1 - 0.59**2), 0, 0, 0, 0]]))
    with pytest.raises(F4xError, match=r"answers more to 'square' \(1.00 against 0.59\)"):
        near.select(scene, Text(("rhomb",)))
    assert near.select(scene, Text(("square",)))


def test_a_label_of_the_asked_kind_answers_for_the_word(scene, monkeypatch):
    """A white square is a square, and evidence for it speaks for "square"; that for a square wall does not."""
    monkeypatch.setattr(knowledge, "null_vector", lambda encoder: np.zeros(8))
    moves = Selection(scene.ids, scene.moving.astype(float), np.zeros(len(scene.ids), bool))
    vectors = np.eye(8, dtype=np.float16)[[0, 3]]

    def answers(labels):
        field = replace(scene.require_field(), vocabularies={"words": Vocabulary(labels, vectors)})
        there = replace(scene, features=field)
        refuse_evidence_of_another(there, "square", moves, lambda name, asked: np.eye(8)[[4]])

    answers(("white square", "wall"))
    monkeypatch.setattr(knowledge, "kinds_of", lambda name: {"shape"} if name == "square" else set())
    answers(("shape", "wall"))  # all squares are shapes
    for other in ("square wall", "disc"):
        with pytest.raises(F4xError, match=f"answers more to '{other}'"):
            answers((other, "wall"))


def test_a_word_for_a_mover_and_its_surroundings_is_no_thing_besides_it():
    moving = np.arange(100) < 30
    car, bus, room = np.arange(100) < 10, np.arange(100) < 25, np.arange(100) < 100
    assert mean_the_same(bus, car, moving)
    assert not mean_the_same(room, car, moving)
    assert not mean_the_same(car, (np.arange(100) > 10) & moving, moving)
