"""The last resort behind the grammar: what it asks about, and how often that is right."""

from collections import Counter

import numpy as np
import pytest
import sentence_cases
import sentence_phrasings

from f4x_core.edit import meaning
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.features import phrasings
from f4x_core.features.text import TEXT_ENCODERS
from f4x_core.language.grammar import Doubt, Slip


def asked(example: sentence_phrasings.Example, operation: str) -> str:
    """right, wrong or nothing: what is asked for a meaning, where the grammar understands no word of it."""
    if not example.slots or meaning.is_barred(example.phrasing):
        return "nothing"
    for said in meaning.sentences(operation, example.slots, example.labels, example.request.selected):
        try:
            fits = sentence_cases._is_meant(example.row, said)
        except (Refusal, KeyError):
            continue
        return "right" if fits and example.row["expect"] == "do" else "wrong"
    return "nothing"


@pytest.fixture(scope="module")
def examples() -> list[sentence_phrasings.Example]:
    return sentence_phrasings.examples()


@pytest.fixture(scope="module")
def words(examples) -> sentence_phrasings.Words:
    return sentence_phrasings.Words([(one.operation, one.phrasing) for one in examples])


@pytest.fixture(scope="module")
def by_words(words) -> np.ndarray:
    return sentence_phrasings.without_itself(words.kernel, words.wanted)


@pytest.fixture(scope="module")
def counted(examples, words):
    """From scores: what is asked about the opened sentences: (whether an edit is meant, right, wrong or nothing) -> how many."""
    opened = {row["text"] for row in sentence_cases.rows(sentence_cases.OPENED)}
    known: dict[tuple[int, str], str] = {}

    def count(scores: np.ndarray, ahead: float) -> Counter:
        found = Counter()
        for at, (example, row) in enumerate(zip(examples, scores, strict=True)):
            if example.row["text"] in opened:
                key = at, phrasings.leading(row, words.names, ahead)
                if key not in known:
                    known[key] = asked(example, key[1])
                found[example.row["expect"] == "do", known[key]] += 1
        return found

    return count


def test_without_the_grammar_and_the_sentence_itself_it_is_mostly_right(by_words, counted):
    found = counted(by_words, phrasings.AHEAD)
    assert found[True, "right"] > 5 * (found[True, "wrong"] + found[False, "wrong"])
    assert found[True, "right"] > 0.4 * sum(n for (do, _), n in found.items() if do)


@pytest.mark.skipif(not TEXT_ENCODERS["minilm"].here, reason="the package of all-MiniLM-L6-v2 is not installed")
def test_with_vectors_it_asks_more_rightly_and_no_more_wrongly(examples, words, by_words, counted):
    vectors = sentence_phrasings.vectors([one.row["text"] for one in examples])
    by_both = (by_words + sentence_phrasings.without_itself(sentence_phrasings.kernel(vectors), words.wanted)) / 2
    alone, both = counted(by_words, phrasings.AHEAD), counted(by_both, phrasings.AHEAD_BY_BOTH)
    assert both[True, "right"] > alone[True, "right"]
    assert both[True, "wrong"] <= alone[True, "wrong"] and both[False, "wrong"] <= alone[False, "wrong"]
    fitted = vectors.T @ np.linalg.solve(sentence_phrasings.kernel(vectors), words.wanted)
    assert (
        np.abs(phrasings.Meanings.of(meaning.PHRASINGS).vectors - fitted).max() < 2e-3
    )  # the file is that of these sentences


@pytest.mark.parametrize(
    ("sentence", "instead"),
    [
        ("I reckon the car wants a teal wash all over, innit", "make the car teal"),
        ("freeze-o the bird at frame 20 chop chop", "freeze the bird at frame 20"),
        ("copy the bird 5 frames", "copy the bird 5 frames later"),
        ("duplicate the car half a second", "copy the car half a second later"),
        ("make a copy of the car 10 frames to the left", "copy the car to the left 10 frames later"),
        ("freeze the car 5 frames", "freeze the car for 5 frames"),
        ("make the car smaller by two", "make the car two times smaller"),
    ],
)
def test_what_the_grammar_refuses_is_asked_about_in_its_own_words(sentence, instead):
    request = Request(sentence, ("car", "bird"), fps=24.0, frames=72)
    with pytest.raises(Doubt, match="I would do: ") as asked:
        parse(request)
    assert not isinstance(asked.value, Slip) and asked.value.instead == instead
    assert parse(Request(instead, request.labels, fps=24.0, frames=72))


@pytest.mark.parametrize(
    "sentence",
    [
        "don't let the car be anything but red",
        "I reckon the car doesn't deserve a teal wash all over, innit",
        "if the bird moves make the car red",
        "make the bird less big by 1.5",
        "make the car less small by two",
        "wibble the wobble",
        "could the bird be zapped where the car is, erase-ish it",
    ],
)
def test_negations_conditions_and_two_things_of_a_removal_are_refused(sentence):
    with pytest.raises(Refusal) as refused:
        parse(Request(sentence, ("car", "bird"), fps=24.0, frames=72))
    assert not isinstance(refused.value, Doubt)


def test_it_asks_where_the_weights_are_not_installed(monkeypatch):
    monkeypatch.setattr(phrasings, "_network", lambda: None)
    with pytest.raises(Doubt) as asked:
        parse(Request("I reckon the car wants a teal wash all over, innit", ("car",), fps=24.0, frames=72))
    assert asked.value.instead == "make the car teal"
