"""Sentences that people say, by meaning: what each comes to in operations or questions, with their slots."""

import pytest
import sentence_cases

from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.request import Request
from f4x_core.language.grammar import Doubt, Slip

REFUSED = (
    "loop the spin from 1 to 2 seconds",
    "is anybody dancing?",
    "dress in #ff8800 for the dancer",
    "blow the dog up to 1.5 times its size without lifting it off the ground",
    "cut the dog out so nothing else is left",
    "hold the last frame of the first second",
    "stretch the jump out so that it lasts twice as long, with a soft ease",
    "the car should fade in, then fade out again at the end",
    "before 1 s leave it as it is, after that make the swan gold",
    "pixelate or blur the licence plate of the car",
    "can I get an echo effect with 4 ghosts trailing the horse, like Echo in AE",
    "two puppies should follow the dog, they do the same a third of a second later each",
    "erase the girl who rides",
    "cut the dog out so I can comp it on something else",
    "Roto the breakdancer out for me, I need him isolated with nothing else in the shot",
    "3 more camels please but copy the one in front",
    "Make warmer the light of all the room",
    "It would be lovely if there were a second swan keeping this one company on the right.",
    "Would that be one camel or two that I'm looking at?",
    "give it an oil painting look but don't touch the swan",
    "cartoon filter but JUST on the car",
    "Anonymise the rider: his head is to be unrecognisable throughout.",
    "Minimum separation of the two camels?",
    "Top speed of the scooter, in km/h if the scale permits.",
    "Relative to the audience, is the woman nearer to or farther from the lens?",
    "make it a twin room: another bed like this one, parallel, to its left",
    "Just checking, this one's a still interior with no movement?",
    "8-bit pixel art shader on the player character (the man)",
    "spawn a ghost racer: man + scooter again, 0.5s behind the originals",
    "Has the horse got somebody riding it, or is it out there all alone?",
    "Legal wants the number plate gone from the car",
    "make it loop for Instagram",
    "can there be ten swans",
    "Hi all, newbie here. How would I go about making the road darker? TIA",
    "swap out the car's paint for cherry red",
    "can we get the dog to glow like he's radioactive, green",
    "Children, let us paint the ball yellow.",
    "wipe the pole from frame 24 onwards",
    "ease the lamp up to 150% brightness over the first second",
    "everyone but the couple in black and white please",
    "lose the clutter-y lamp on the left and brighten the wall",
    "set enemy (the dog) alpha to 0.3",
    "rewind that bit where the horse jumps, from frame 20 to 44",
    "from one second onwards the train is green before that it stays as it is",
    "it needs delete of the traffic cone",
    "turn the chair in direction of left by 30 grades",
    "Tint specimen blue, 50% strength, frames 0-30",
    "Duplicate the sample thrice along the horizontal",
    "where the chair is I want the table and the other way round",
    "move the bike from the left side to the right side of the tree",
    "make it half transparent while the car passes, seconds 1 to 2",
    "start with the boat invisible and let it fade in over one second",
    "give me the gap between the two cars in car lengths at 2 s",
    "Please to make the boat more little, the half of now",
    "Make darker the sky, but only a few",
    "Is there a cat on the bed, or am I seeing things?",
    "twice the dancer please, the second one left of her and 10 frames late",
    "make her smaller and smaller until she's half her size at the end",
    "hide the people in the background",
    "the dancer ought to glow softly in pink during the twirl, from 0.8 to 1.6 seconds",
    "everything black and white except for the car, which should be red",
    "the swan fades from black to white during the clip",
    "all the leaves on the ground should be gone",
    "please make two more kids jumping next to her",
    "Is it possible to have the bench twice?",
    "Okie dokie, let's get that buoy in bright orange",
    "2x, first half",
    "Now the big tree should turn orange, as in fall",
    "Now, class, let us paint the locomotive green and the wagon yellow.",
    "Kindly isolate the scooter and its rider for the report.",
    "For the file, show the vehicle in isolation, without any of the surroundings.",
    "been at this for hours lol, i just want the leaves to look like autumn",
)
"""Sentences that are not understood, and refused. None else may be, and none may be misunderstood."""
PARTS, EVERY_DAY = 8, 2
"""Tests that the sentences are shared out to, and how many of them run every day; the others are slow tests, which CI runs."""
NUMBERS = [pytest.param(part, marks=pytest.mark.slow) if part >= EVERY_DAY else part for part in range(PARTS)]
ROWS = [*sentence_cases.rows(), *sentence_cases.rows(sentence_cases.OPENED)]


def test_the_share_that_is_understood():
    """All rows but the refused ones are right, as the next test says of each."""
    assert {*REFUSED} <= {row["text"] for row in ROWS}
    assert 1 - len(REFUSED) / len(ROWS) >= 0.92


@pytest.mark.parametrize("part", NUMBERS)
def test_sentences_mean_what_a_person_means(part):
    found = [(row["text"], sentence_cases.verdict(row)) for row in ROWS[part::PARTS]]
    assert not [one for one in found if one[1] != ("refused" if one[0] in REFUSED else "right")]


@pytest.mark.parametrize("part", NUMBERS)
def test_what_english_has_for_each_slot_comes_to_its_summary(part):
    compare_summaries(sentence_cases.LISTED[part::PARTS])


def test_sentences_in_other_words_come_to_their_summaries():
    compare_summaries(sentence_cases.REWORDED)


def compare_summaries(lines):
    wrong = {}
    for line in lines:
        sentence, summary = line.rsplit(" => ", 1)
        try:
            told = " + ".join(
                map(describe, parse(Request(sentence, sentence_cases.REWORDED_LABELS, fps=24.0, frames=72)))
            )
        except Refusal as refusal:
            told = "asked" if summary == "asked" else refusal.reason
        if told != summary:
            wrong[sentence] = told
    assert not wrong


@pytest.mark.parametrize(
    ("sentence", "mended"),
    [
        ("Make the car green for the frist second", "first"),
        ("the car shoud be blue", "should"),
        ("a slighlty bigger car", "slightly"),
    ],
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
        ("make a smaller copy of the bird to the left",
         ["copy the bird by 1.2 widths to the left, called copy", "make the copy 33 % smaller"]),
        ("play the last second in slow motion", ["play everything at half speed from frame 47 on"]),
        ("make the woman in red glow", ["make the woman in red glow by 50 %"]),
        ("don't touch the car, but make the bird gray", ["make the bird black and white"]),
        ("I don't want to see the car any more", ["remove the car"]),
        ("the bird has to go", ["remove the bird"]),
        ("turn the bird red by second 2", ["make the bird red from frame 48 on"]),
        ("the bird would look better in blue", ["make the bird blue"]),
        ("I was thinking the bird could be pink", ["make the bird pink"]),
        ("a white bird would be nicer", ["make the bird white"]),
        ("the car is in the way, get rid of it", ["remove the car"]),
        ("nobody needs that car, kill it", ["remove the car"]),
        ("my boss wants the car to be green", ["make the car green"]),
        ("perfect. next: blur the car", ["blur the car by 0.02 units"]),
        ("anonymise the woman, i.e. blur her", ["blur the woman by 0.02 units"]),
        ("the bird is a bit small", ["make the bird 50 % bigger"]),
        ("not bright enough", ["make everything 50 % brighter"]),
        ("could the car be a darker blue", ["make the car rgb 0, 0, 0.5"]),
        ("paint the car in a nice walnut brown", ["make the car brown"]),
        ("bird red until second 1, then blue",
         ["make the bird red from frame 0 to frame 24", "make the bird blue from frame 24 on"]),
        ("the bird should be where the car is and vice versa", ["swap the bird with the car"]),
        ("have the bird pop up at second 1", ["hide the bird from frame 0 to frame 24"]),
        ("a bigger bird, and move it to the left", ["make the bird 50 % bigger", "move the bird by 1 width to the left"]),
    ],
)  # fmt: skip
def test_any_verb_goes_with_any_slot(sentence, told):
    labels = ("bird", "car", "woman")
    assert [describe(one) for one in parse(Request(sentence, labels, fps=24.0, frames=72))] == told


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
