"""Sentences that people say, by meaning: what each comes to in operations or questions, with their slots."""

import pytest
import sentence_cases

from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.language.refusal import Doubt, Slip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "right", "wrong"), [(sentence_cases.OPENED, 0.79, 12), (sentence_cases.SEALED, 0.78, 5)]
)
def test_so_many_sentences_mean_what_a_person_means(path, right, wrong):
    """They are counted and not listed, so that nobody mends the language for one of them."""
    found = [sentence_cases.verdict(row) for row in sentence_cases.rows(path)]
    assert found.count("right") / len(found) >= right
    assert found.count("wrong") <= wrong


@pytest.mark.parametrize(
    ("sentence", "mended"), [("Make the car green for the frist second", "first"), ("the car shoud be blue", "should")]
)
def test_a_sure_slip_is_mended_where_nothing_is_removed(sentence, mended):
    with pytest.raises(Slip) as slip:
        parse(Request(sentence, ("car",), fps=24.0, frames=72))
    assert mended in slip.value.instead and parse(Request(slip.value.instead, ("car",), fps=24.0, frames=72))
    with pytest.raises(Doubt) as asked:
        parse(Request("remvoe the car", ("car",), fps=24.0, frames=72))
    assert not isinstance(asked.value, Slip)


@pytest.mark.parametrize(
    "sentence",
    [
        "make some birds red",
        "make the fastest bird red",
        "delete the third bird",
        "show the bird only in the first second",
        "make the bird or the car red",
        "swap the color of the bird",
        "take it back",
        "move the bird with the car to the left",
        "make the bird dance",
        "play the bird twice",
        "make the bird red, nothing blue",
        "stop the bird after one second and start it again at two seconds",
        "does the bird look big",
        "I'm afraid the bird will be removed",
    ],
)
def test_half_an_understanding_is_none(sentence):
    with pytest.raises(Refusal):
        parse(Request(sentence, ("bird", "car"), fps=24.0, frames=72, selected=True))


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("the bird should be a third smaller", ["make the bird 33.3 % smaller"]),
        ("paint the bird red and do the same with the car", ["make the bird red", "make the car red"]),
        ("make the bird red at the beginning and blue at the end",
         ["make the bird red from frame 0 to frame 24", "make the bird blue from frame 47 on"]),
        ("play the last second in slow motion", ["play everything at half speed from frame 47 on"]),
        ("make the woman in red glow", ["make the woman in red glow by 50 %"]),
        ("don't touch the car, but make the bird gray", ["make the bird but not the car black and white"]),
        ("I don't want to see the car any more", ["remove the car"]),
        ("the bird has to go", ["remove the bird"]),
        ("turn the bird red by second 2", ["make the bird red from frame 48 on"]),
        ("the bird would look better in blue", ["make the bird blue"]),
        ("a white bird would be nicer", ["make the bird white"]),
        ("my boss wants the car to be green", ["make the car green"]),
        ("the bird is a bit small", ["make the bird 50 % bigger"]),
        ("not bright enough", ["make everything 50 % brighter"]),
        ("too much contrast, take it down a notch", ["set the contrast of everything to 83 %"]),
        ("the car is too dark, bring it up by 30%", ["make the car 30 % brighter"]),
        ("too bright on the car, knock it down half a stop", ["lower the exposure of the car by 0.5 stops"]),
        ("more contrast on the car, less saturation",
         ["set the contrast of the car to 150 %", "set the saturation of the car to 67 %"]),
        ("gain 1.1 on the car, gamma 0.9, saturation +5%",
         ["set the exposure of the car to 110 %", "set the gamma of the car to 0.9", "set the saturation of the car to 105 %"]),
        ("exposure +0.5 on the bird, overall contrast +10%",
         ["raise the exposure of the bird by 0.5 stops", "set the contrast of everything to 110 %"]),
        ("key light warmer on the bird", ["make the bird 50 % warmer"]),
        ("colder light on the car", ["make the car 50 % cooler"]),
        ("more contrast, but not on the car", ["set the contrast of everything except the car to 150 %"]),
        ("could the car be a darker blue", ["make the car rgb 0, 0, 0.5"]),
        ("bird red until second 1, then blue",
         ["make the bird red from frame 0 to frame 24", "make the bird blue from frame 24 on"]),
    ],
)  # fmt: skip
def test_any_verb_goes_with_any_slot(sentence, told):
    labels = ("bird", "car", "woman")
    assert [describe(one) for one in parse(Request(sentence, labels, fps=24.0, frames=72))] == told


@pytest.mark.parametrize("sentence", ["do not darken the car", "never brighten the bird", "no contrast on the car"])
def test_what_is_not_to_be_done_is_not_offered(sentence):
    with pytest.raises(Refusal) as refusal:
        parse(Request(sentence, ("bird", "car"), fps=24.0, frames=72))
    assert not refusal.value.nearest


def test_what_was_levelled_can_be_repeated_for_another():
    earlier = "the car is too dark, bring it up by 30%"
    found = parse(Request("the same for the bird", ("bird", "car"), fps=24.0, frames=72), earlier=earlier)
    assert [describe(one) for one in found] == ["make the bird 30 % brighter"]


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("slow motion, please", ["play everything at half speed"]),  # the frame before asks whom it is for
        ("slow down the last second", ["play everything at 67 % speed from frame 47 on"]),
        ("make it brighter", ["make everything 50 % brighter"]),
    ],
)
def test_where_a_frame_fits_and_cannot_be_carried_out_the_next_is_asked(sentence, expected):
    assert [describe(one) for one in parse(Request(sentence, ("bird", "car"), fps=24.0, frames=72))] == expected


@pytest.mark.parametrize(
    "sentence",
    [
        "the bird runs to the car, hide it",
        "the same for the car",
        "make one of the birds red",
        "swap the bird for a car",
        "make it bigger",
        "shrink it by 20%",
        "make everything else brighter",
        "make the left one brighter",
        "make them brighter",
    ],
)
def test_of_whom_is_spoken_is_not_guessed(sentence):
    with pytest.raises(Refusal) as refusal:
        parse(Request(sentence, ("bird", "car"), fps=24.0, frames=72))
    assert not isinstance(refusal.value, Doubt)
