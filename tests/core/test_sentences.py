"""Sentences that people say, by meaning: what each comes to in operations or questions, with their slots."""

import pytest
import sentence_cases

REFUSED = (
    "dress in #ff8800 for the dancer",
    "blur the crowd behind the dancer",
    "blow the dog up to 1.5 times its size without lifting it off the ground",
    "bring the camel closer to the wall",
    "move the dog behind the bush",
    "stand the dancer on his feet: turn him by 180 degrees",
    "make another dog, smaller, next to this one",
    "give me one more of those cars, half the size",
    "cut the dog out so nothing else is left",
    "hold the last frame of the first second",
    "loop the spin from 1 to 2 seconds",
    "stretch the jump out so that it lasts twice as long, with a soft ease",
    "the car should fade in, then fade out again at the end",
    "fade everything to black at the end",
    "before 1 s leave it as it is, after that make the swan gold",
    "the guy in the red jacket should become twice as large",
    "is anybody dancing?",
)
"""Sentences that are not understood, and refused. None else may be, and none may be misunderstood."""
ROWS = sentence_cases.rows()


def test_the_share_that_is_understood():
    right = sum(sentence_cases.verdict(row) == "right" for row in ROWS)
    assert right / len(ROWS) >= 0.92


@pytest.mark.parametrize("row", ROWS, ids=[row["text"] for row in ROWS])
def test_a_sentence_means_what_a_person_means(row):
    assert sentence_cases.verdict(row) == ("refused" if row["text"] in REFUSED else "right")
