"""Other ways to say what the grammar knows come to the same operations; what comes little by little says so."""

import pytest

from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.language.paraphrases import paraphrases

SAME = (
    ("bird: red", "make the bird red"),
    ("keep what moves", "keep only what moves"),
    ("red bird, please!", "make the bird red"),
    ("would it be possible to have the bird in red?", "make the bird red"),
    ("the bird would look better in blue", "make the bird blue"),
    ("make the bird red, no wait, blue", "make the bird blue"),
    ("what if the bird was blue", "make the bird blue"),
    ("give the car a fresh coat of green paint", "paint the car green"),
    ("change the color of the bird to match the car", "match the bird to the car"),
    ("tint the car slightly orange", "make the car slightly orange"),
    ("the car shouldn't be there", "remove the car"),
    ("don't show the car", "hide the car"),
    ("the bird shouldn't move after second 1", "freeze the bird after second 1"),
    ("delete the car but keep the bird", "delete the car"),
    ("never touch the car, make everything else gray", "leave the car alone and make everything else gray"),
    ("make everything gray but not the bird", "make everything gray except the bird"),
    ("everything black and white except for the bird", "make everything black and white except the bird"),
    ("bird away after 2 s", "hide the bird after second 2"),
    ("a ghost of the bird should follow it half a second later", "let a copy follow the bird half a second behind"),
    ("add a second bird behind the first one", "put a copy of the bird behind it"),
    ("stop time at one second", "freeze everything at second 1"),
    ("instead of being red, make the bird blue", "make the bird blue"),
    ("perk the bird up", "perk up the bird"),
    ("make the bird red, but first remove the car", "make the bird red. remove the car"),
    ("make the car red with its shadow", "make the car and its shadow red"),
)
WITHIN = {"labels": ("bird", "car"), "fps": 24.0, "frames": 72}


def told(sentence):
    return [describe(one) for one in parse(Request(sentence, **WITHIN))]


@pytest.mark.parametrize(("sentence", "known"), SAME[:-1])
def test_a_paraphrase_means_what_the_known_sentence_means(sentence, known):
    assert told(sentence) == told(known) != []


@pytest.mark.parametrize(
    "sentence",
    [
        "if the bird moves make it red",
        "make the bird happy",
        "never mind",
        "full colour only on the bird",
        "change the bird so that it is red",
        "the bird should not be red, but blue",
        "swap the bird's red for blue",
        "the only thing in colour should be the bird",
    ],
)
def test_no_paraphrase_makes_sense_of_what_has_none(sentence):
    with pytest.raises(Refusal):
        parse(Request(sentence, **WITHIN))


def test_a_sentence_is_no_paraphrase_of_itself():
    assert "make the bird red" not in paraphrases("make the bird red")
    assert "make the bird blue" in paraphrases("Please, what if the bird was blue?")


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("slowly turn the bird red", "gradually make the bird red from frame 0 to the end"),
        (
            "make the bird gradually blue between 1 and 2 seconds",
            "gradually make the bird blue from frame 24 to frame 48",
        ),
        ("slowly make the picture warmer", "gradually make everything 50 % warmer from frame 0 to the end"),
        ("gradually make the bird look like gold", "gradually make the bird look like gold from frame 0 to the end"),
    ],
)
def test_colours_come_little_by_little(sentence, expected):
    assert told(sentence) == [expected]
    assert told(expected) == [expected], "what is told can be said"


def test_showing_at_a_time_is_asked_about():
    with pytest.raises(Refusal, match="two ways"):
        parse(Request("show the bird from second 2", **WITHIN))
    assert told("show the bird again from second 2") == ["show the bird again from frame 48 on"]


@pytest.mark.parametrize("sentence", ["make the bird red only at frame 50", "make the bird red, but only at frame 50"])
def test_only_at_a_frame_is_that_frame_alone(sentence):
    assert told(sentence) == ["make the bird red from frame 50 to frame 50"]
