"""The last resort behind the grammar: what it asks about, and how often that is right."""

from collections import Counter

import numpy as np
import pytest
import sentence_cases
import sentence_phrasings

from f4x_core.edit import meaning
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.language.grammar import Doubt, Slip


def without_itself(model: meaning.Meanings) -> np.ndarray:
    """(rows, operations): the scores of each phrasing by a regression that never saw it."""
    inverse = np.linalg.inv(model.kernel)
    return model.wanted - inverse @ model.wanted / np.diag(inverse)[:, None]


def asked(example: sentence_phrasings.Example, row: np.ndarray, names: list[str]) -> str:
    """right, wrong or nothing: what is asked by the scores alone, where the grammar understands no word of it."""
    if not example.slots or meaning.is_barred(example.phrasing):
        return "nothing"
    first, second = np.argsort(-row)[:2]
    if row[first] < meaning.CERTAIN or row[first] - row[second] < meaning.AHEAD:
        return "nothing"
    for said in meaning.sentences(names[first], example.slots, example.labels, example.request.selected):
        try:
            fits = sentence_cases._is_meant(example.row, said)
        except (Refusal, KeyError):
            continue
        return "right" if fits and example.row["expect"] == "do" else "wrong"
    return "nothing"


def test_without_the_grammar_and_the_sentence_itself_it_is_mostly_right():
    opened = {row["text"] for row in sentence_cases.rows(sentence_cases.OPENED)}
    examples = sentence_phrasings.examples()
    model = meaning.Meanings([(one.operation, one.phrasing) for one in examples])
    scores = without_itself(model)
    found = Counter()
    for example, row in zip(examples, scores, strict=True):
        if example.row["text"] in opened:
            found[example.row["expect"] == "do", asked(example, row, model.operations)] += 1
    assert found[True, "right"] > 5 * (found[True, "wrong"] + found[False, "wrong"])
    assert found[True, "right"] > 0.4 * sum(n for (do, _), n in found.items() if do)


@pytest.mark.parametrize(
    ("sentence", "instead"),
    [
        ("I reckon the car wants a teal wash all over, innit", "make the car teal"),
        ("freeze-o the bird at frame 20 chop chop", "freeze the bird at frame 20"),
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
        "wibble the wobble",
        "could the bird be zapped where the car is, erase-ish it",
    ],
)
def test_negations_conditions_and_two_things_of_a_removal_are_refused(sentence):
    with pytest.raises(Refusal) as refused:
        parse(Request(sentence, ("car", "bird"), fps=24.0, frames=72))
    assert not isinstance(refused.value, Doubt)
