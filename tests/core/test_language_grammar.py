"""Rules that know the words they begin with, and words that are one slip away."""

import pytest

from f4x_core.language import lexicon, notation
from f4x_core.language.grammar import Reading, Rule, constant, either, listed, optional, silent, table, tokenise, unless

COLOUR = table({"red|dark red": "r", "blue": "b"}, vocabulary=set())
THE = table({"the|a": None}, vocabulary=set())


@pytest.mark.parametrize(
    ("rule", "words", "may_be_empty"),
    [
        (COLOUR, {"red", "dark", "blue"}, False),
        (THE + COLOUR, {"the", "a"}, False),
        (either(THE, COLOUR), {"the", "a", "red", "dark", "blue"}, False),
        (COLOUR >> str.upper, {"red", "dark", "blue"}, False),
        (silent(THE), {"the", "a"}, False),
        (~THE, {"the", "a"}, True),
        (~THE + COLOUR, {"the", "a", "red", "dark", "blue"}, False),
        (~THE + ~COLOUR, {"the", "a", "red", "dark", "blue"}, True),
        (optional(THE), {"the", "a"}, True),
        (THE | constant(1), {"the", "a"}, True),
        (unless(THE) + COLOUR, {"red", "dark", "blue"}, False),
        (listed(~THE + COLOUR, THE), {"the", "a", "red", "dark", "blue"}, False),
        (Rule(lambda reading, at: {at: ()}), None, False),
        (~THE + Rule(lambda reading, at: {at: ()}), None, False),
    ],
)
def test_a_rule_knows_the_words_it_begins_with(rule, words, may_be_empty):
    assert (rule.first, rule.may_be_empty) == (words, may_be_empty)


@pytest.mark.parametrize("sentence", ["the dark red", "dark dark", "a", "", "blue the red", "green"])
@pytest.mark.parametrize(
    "rule", [COLOUR, THE + COLOUR, either(THE + COLOUR, COLOUR), ~THE + (COLOUR >> str.upper), ~THE + ~COLOUR]
)
def test_where_a_rule_cannot_begin_it_has_no_match(rule, sentence):
    for at in range(len(sentence.split()) + 1):
        asked, matched = (Reading(sentence) for _ in range(2))
        assert rule.at(asked, at) == rule.match(matched, at)


KNOWN = {"brighter", "remove", "should", "contrast", "opacity", "background", "river", "hike", "edit", "lower", "not"}


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("brigther", "brighter"), ("remvoe", "remove"), ("shoud", "should"), ("oppacity", "opacity"), ("edot", "edit"),
        ("contarst", "contrast"), ("nto", "not"), ("rider", None), ("bike", None), ("exit", None), ("power", None),
        ("river", None),
    ],
)  # fmt: skip
def test_a_word_is_misspelt_where_fingers_slip(typed, meant):
    assert lexicon.misspelt(typed, KNOWN) == meant


SAY = notation.Notation({"colour": COLOUR})


@pytest.mark.parametrize(
    ("phrase", "sentence", "values"),
    [
        ("by <colour>", "by dark red", ("r",)),
        ("(very) <colour> [paint|tint]", "blue paint", ("b",)),
        ("(very) <colour> [paint|tint]", "very red tint", ("r",)),
        ("paint <colour?>", "paint", (None,)),
        ("paint <.colour>", "paint red", ()),
        ("[in <colour>|plain]", "in blue", ("b",)),
        ("[in <colour>|plain]", "plain", ()),
        ("![dark|deep] <colour>", "dark red", None),
        ("![dark|deep] <colour>", "red", ("r",)),
        ("{blur}|nothing", "blurring", ()),
        ("{=sit} (<colour>)", "sits red", ("r",)),
        ("(in|with) <colour>|<colour> too", "red too", ("r",)),
        ("(a|the)", "", ()),
    ],
)
def test_phrases_are_read_as_they_are_written(phrase, sentence, values):
    ways = SAY(phrase).at(Reading(sentence), 0)
    assert ways.get(len(tokenise(sentence))) == values


def test_in_a_table_of_phrases_the_first_that_fits_gives_its_value_or_makes_one():
    rule = SAY.table({"very <colour>": str.upper, "very <colour>|plain": "plain", "(a) <mark> hue": 1.0}, mark=COLOUR)
    found = {sentence: rule.at(Reading(sentence), 0) for sentence in ("very red", "plain", "a red hue")}
    assert found == {"very red": {2: ("R",)}, "plain": {1: ("plain",)}, "a red hue": {3: (1.0,)}}
