"""Plans that are asked about although every word is explained, and what is not."""

import pytest

from f4x_core.edit.description import in_words
from f4x_core.edit.language import parse
from f4x_core.edit.request import Request
from f4x_core.features import phrasings
from f4x_core.features.text import TEXT_ENCODERS
from f4x_core.language.grammar import Doubt

LABELS = ("car", "dog", "bird", "bush")


def read(sentence: str) -> str:
    return in_words(parse(Request(sentence, LABELS, fps=24.0, frames=72)))


@pytest.mark.parametrize(
    ("sentence", "why"),
    [
        ("hide the car, then blur the car", "Of the car nothing would be seen"),
        ("paint the car green and let the car look like neon", "about the same thing at the same time"),
        ("rotate the bird by 360 degrees, rotate everything by 360 degrees", "are the same"),
    ],
)
def test_operations_that_do_not_go_together_are_asked_about_and_sure_in_their_own_words(sentence, why):
    with pytest.raises(Doubt, match=why) as asked:
        read(sentence)
    assert read(asked.value.instead) == asked.value.instead


@pytest.mark.skipif(not TEXT_ENCODERS["minilm"].here, reason="the package of all-MiniLM-L6-v2 is not installed")
def test_an_operation_that_nothing_speaks_for_is_asked_about(monkeypatch):
    monkeypatch.setattr("f4x_core.edit.misgivings.SPOKEN_FOR", 0.9)
    sentence = "paint the car teal, quickly duplicate that bird over there"
    with pytest.raises(Doubt, match="not sure that"):
        read(sentence)
    monkeypatch.setattr(phrasings, "_network", lambda: None)
    assert read(sentence).startswith("make the car teal; copy the bird")


@pytest.mark.parametrize(
    "sentence",
    [
        "make the car red, then blue after one second",
        "make the dogs black and the left dog white",
        "hide the car from second 1 to 2, then make it red",
        "make the car yellow, spin it clockwise and finally fade it out",
        "darken everything but make the car brighter",
        "call the dog rex and make rex red",
    ],
)
def test_plans_that_go_together_are_not_asked_about(sentence):
    assert read(sentence)
