"""The commands that a refusal offers: how often the one that was meant is among them, and that nothing is done on a guess."""

import numpy as np
import pytest
import sentence_phrasings

from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.features import phrasings
from f4x_core.features.phrasings import NOTHING
from f4x_core.language.grammar import Doubt

OFFERED = 3
LABELS = ("car", "bird")


def refusal(sentence):
    with pytest.raises(Refusal) as refused:
        parse(Request(sentence, LABELS, fps=24.0, frames=72))
    assert not isinstance(refused.value, Doubt)
    return refused.value


def test_what_is_meant_is_among_the_nearest_of_a_table_that_never_saw_the_sentence():
    examples = sentence_phrasings.examples()
    words = sentence_phrasings.Words([(one.operation, one.phrasing) for one in examples])
    scores = sentence_phrasings.without_itself(words.kernel, words.wanted)
    scores[:, words.names.index(NOTHING)] = -1
    nearest = np.argsort(-scores, axis=1)[:, :OFFERED]
    right = [
        one.operation in [words.names[at] for at in row]
        for one, row in zip(examples, nearest, strict=True)
        if one.operation != NOTHING
    ]
    assert np.mean(right) > 0.85


@pytest.mark.parametrize("installed", [True, False])
@pytest.mark.parametrize(
    ("sentence", "offered"),
    [
        ("I reckon the car wants a teal wash all over, innit", "make the car teal"),
        ("freeze-o the bird at frame 20 chop chop", "freeze the bird"),
    ],
)
def test_what_is_refused_is_offered_in_the_words_of_the_language(sentence, offered, installed, monkeypatch):
    if not installed:
        monkeypatch.setattr(phrasings, "_network", lambda: None)
    assert offered in refusal(sentence).nearest


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
    refusal(sentence)
