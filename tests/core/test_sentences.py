"""Sentences that people say, by meaning: what each comes to in operations or questions, with their slots."""

import pytest
import sentence_cases

REFUSED = (
    "I want a white swan instead of a black one",
    "dress in #ff8800 for the dancer",
)
"""Sentences that are not understood, and refused. None else may be, and none may be misunderstood."""
ROWS = sentence_cases.rows()


def test_the_share_that_is_understood():
    right = sum(sentence_cases.verdict(row) == "right" for row in ROWS)
    assert right / len(ROWS) >= 0.9


@pytest.mark.parametrize("row", ROWS, ids=[row["text"] for row in ROWS])
def test_a_sentence_means_what_a_person_means(row):
    assert sentence_cases.verdict(row) == ("refused" if row["text"] in REFUSED else "right")
