"""What is left out of a sentence: without asking what adds nothing by its class and place, and after asking what nobody knows."""

import re
from contextlib import suppress

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.operations import Delete
from f4x_core.edit.request import Request
from f4x_core.language.grammar import NOTHING, Doubt, Reading, tokenise
from f4x_core.language.idle import HARMLESS, UNKNOWN, idle_gaps
from f4x_core.language.lexicon import word_set
from f4x_core.language.verbs import COMMAND_VERBS

LABELS = ("dog", "cat", "car", "tree", "swan", "hat")
COMMANDS = (
    ("make the dog red", "make the dog red"),
    ("make the dog 20 % bigger", "scale the dog by 1.2"),
    ("move the cat two widths to the left", "move the cat by 2 widths to the left"),
    ("make everything gray except the dog", "make everything except the dog black and white"),
    ("hide the tree from second 1 to 2", "hide the tree from frame 24 to frame 48"),
)
ASIDES = (
    "{}, please", "{}, if that's not too much trouble", "{} when you get a chance", "{}, thanks a lot in advance",
    "{} because it annoys me", "lol {}", "mommy, please {}", "{} so we can show it to my boss", "{}, that would be great",
    "{}, if you don't mind", "honestly {}", "could somebody {}?", "{} for my thumbnail", "{} haha", "by the way, {}",
    "ok cool, now {}", "perfect. {}", "since it's Halloween, {}", "my boss wants you to {}", "I was wondering if you could {}",
    "do me a favour and {}", "would it be possible to {}?", "why don't you {}", "one last thing, {}", "last but not least {}",
    "it would mean a lot to me if you could {}", "lowkey {}", "uh {} ngl", "{} right now", "any way to {}?", "I beg you to {}",
    "could you possibly {}", "first off, {}",
)  # fmt: skip
STRANGE = ("wobbly", "in a zorbly manner", "and happy", "quintessentially", "using acrylics")


def told(sentence, labels=LABELS, **state):
    return [describe(one) for one in parse(Request(sentence, labels, fps=24.0, frames=72, **state))]


@pytest.mark.parametrize("command", [command for command, _ in COMMANDS])
def test_what_adds_nothing_is_left_out_unasked(command):
    plain = told(command)
    assert {aside: told(aside.format(command)) for aside in ASIDES} == dict.fromkeys(ASIDES, plain)


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("make the swan pink like a flamingo", ["make the swan pink"]),
        ("red dog, blue car, thanks", ["make the dog red", "make the car blue"]),
        ("turn the whole car to silver", ["make the car look like silver"]),
        ("I need three dogs instead of one", ["copy the dog 2 times by 1.2 widths to the right"]),
        ("black and white, please", ["make everything black and white"]),
        ("make the first 24 frames night", ["make everything look like night from frame 0 to frame 24"]),
        ("a huuuge swan please", ["make the swan twice as big"]),
        ("make the dog look left", ["rotate the dog by 90 degrees to the left"]),
        ("the car, make it a bit see-through", ["give the car 80 % opacity"]),
        ("let the dog appear slowly over the first second", ["fade in the dog from frame 0 to frame 24"]),
        ("car: black, half its size, moved to the right",
         ["make the car black", "make the car half as big", "move the car by 1 width to the right"]),
        ("make the swan glow during the last 12 frames only", ["make the swan glow by 50 % from frame 59 on"]),
    ],
)  # fmt: skip
def test_classes_of_words(sentence, expected):
    assert told(sentence) == expected


@pytest.mark.parametrize("strange", STRANGE)
@pytest.mark.parametrize(("command", "expected"), COMMANDS[:1] + COMMANDS[2:3])
def test_what_nobody_knows_is_asked_about(command, expected, strange):
    with pytest.raises(Doubt) as doubt:
        told(f"{command} {strange}")
    assert expected in doubt.value.reason and strange.split()[-1] in doubt.value.reason
    assert told(doubt.value.instead) == [expected], "what is said instead means what the question says"


@pytest.mark.parametrize(
    ("sentence", "words"),
    [("roto the car and put it on black", "on"), ("remove the tree of", "of"), ("hide the cat along", "along")],
)
def test_nothing_is_taken_out_where_a_word_is_left_unexplained(sentence, words):
    with pytest.raises(Doubt, match=f"I would do: .*'{words}"):
        told(sentence)


@pytest.mark.parametrize(
    "sentence",
    [
        "make the dog not wobbly red",
        "make the dog red unless the zorble comes",
        "make the dog wobbly 3",
        "paint the dog red without wobbling",
        "put a party hat on the dog",
        "put sunglasses on the cat",
        "make the dog sing a song",
        "add a sunset",
        "add fire to the car",
        "add snow",
        "draw a circle around the dog",
        "delete",
        "make the dog taller",
    ],
)
def test_what_would_change_what_is_done_is_never_left_out(sentence):
    with pytest.raises(Refusal) as refusal:
        told(sentence, selected=True)
    assert not isinstance(refusal.value, Doubt)


@pytest.mark.parametrize(
    "sentence", ["put a party hat on the dog", "add a rainbow", "add some rain", "draw a beard", "add a sunset"]
)
def test_of_a_new_thing_it_is_said_that_it_cannot_be_made(sentence):
    with pytest.raises(Refusal, match="Nothing new can be made"):
        told(sentence)


def test_of_what_is_gone_the_reason_is_asked_about():
    with pytest.raises(Doubt, match=r"remove the dog.*reason") as doubt:
        told("cut the dog out so I can put it in my film")
    assert isinstance(parse(Request(doubt.value.instead, LABELS, fps=24.0, frames=72))[0], Delete)


def test_a_reason_that_holds_a_command_is_no_aside():
    for sentence in (
        "make the dog red because I like it and delete the cat",
        "make the dog red so we can hide the cat",
    ):
        with suppress(Refusal):  # both or none
            assert len(told(sentence)) == 2


WORDS = st.sampled_from(
    sorted(
        word_set(
            "make the dog red not except without only 3 20 % second left right zorble wobbly like a so cat if unless and half it"
        )
    )
)


@settings(max_examples=200, deadline=None)
@given(st.lists(WORDS, min_size=2, max_size=14).map(" ".join))
def test_no_number_negation_limit_or_thing_is_left_unexplained(text):
    tokens = tokenise(text)
    gaps = idle_gaps(Reading.of(text, tokens, {}), NOTHING, LABELS, COMMAND_VERBS)
    for at, ends in enumerate(gaps):
        word = tokens[at].text
        if re.fullmatch(r"\d+|%|not|except|without|only|unless|if|left|right|second|half|red|dog|cat|make", word):
            assert not ends
        if word in ("zorble", "wobbly"):
            told = at + 1 < len(tokens) and tokens[at + 1].text == "red"  # how something red is
            assert ends == {at + 1: HARMLESS if told else UNKNOWN}


@settings(max_examples=60, deadline=None)
@example("cat right wobbly cat only")
@example("red cat cat without it")
@given(st.lists(WORDS, min_size=2, max_size=10).map(" ".join))
def test_every_question_names_what_its_sentence_does(text):
    try:
        told(text)
    except Doubt as doubt:
        if doubt.reason.startswith("I would do: "):
            assert "; ".join(told(doubt.instead)) in doubt.reason
    except Refusal:
        pass


@pytest.mark.parametrize("command", ["make the dog red", "hide the tree from second 1 to 2"])
@pytest.mark.parametrize(
    "remarked",
    ["{}, it frightens me", "evening mood: {}", "{}, so it looks like it is gone", "{}, my eyes are not what they used to be",
     "{}, nothing fancy", "{}, like in the old films", "{}, it sits in the way", "{}. Can you do that?"],
)  # fmt: skip
def test_a_remark_that_wishes_nothing_is_left_out(command, remarked):
    assert told(remarked.format(command)) == told(command)


@pytest.mark.parametrize(
    "sentence",
    [
        "make the dog red, it must bark",
        "make the dog red, the cat is blue",
        "make the dog red, it turns into a cat",
        "make the dog red, my cat is too",
        "make the dog red, I need it to dance",
        "party mood: make the dog dance",
        "change the dog so it looks like a cat",
        "make the dog look like a cat",
        "zorbl the dog red",
    ],
)
def test_a_remark_that_may_be_a_wish_is_never_left_out(sentence):
    with pytest.raises(Refusal):
        told(sentence)
