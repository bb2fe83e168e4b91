"""The table of cues as it is read: values, alternatives, optional words, and references."""

import pytest

from f4x_core.language.grammar import Reading
from f4x_core.query import cues


def ends(rule, sentence):
    """Word at which each match from the first word on ends, and the values it gives."""
    return dict(rule.at(Reading(sentence), 0))


TABLE = """
beast: dog|[cat|kitten] (here)
big: large|very <.beast>|{=move}
size = much: a lot (of <.beast>)
size = little: a bit
"""


@pytest.mark.parametrize(
    ("name", "sentence", "matches"),
    [
        ("beast", "dog", {1: ()}),
        ("beast", "kitten here", {2: (), 1: ()}),
        ("beast", "here", {}),
        ("big", "large", {1: ()}),
        ("big", "very cat here", {3: (), 2: ()}),
        ("big", "very", {}),
        ("big", "moving", {1: ()}),
        ("big", "moves", {1: ()}),
        ("size", "a lot", {2: ("much",)}),
        ("size", "a lot of dog", {2: ("much",), 4: ("much",)}),
        ("size", "a bit", {2: ("little",)}),
        ("size", "a dog", {}),
        ("color", "light red", {2: ("light red",)}),
        ("color", "red or blue", {3: ("red or blue",), 1: ("red",)}),
    ],
)
def test_a_line_of_the_table(name, sentence, matches):
    assert ends(cues._read(TABLE)[name], sentence) == matches
