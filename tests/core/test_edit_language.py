"""Sentences to operations: a table of phrases that was written before the parser, properties of any text, and back to words."""

import json
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from f4x_core.edit import styles
from f4x_core.edit.change import SHOWN
from f4x_core.edit.commands import COMMANDS
from f4x_core.edit.description import describe, in_words
from f4x_core.edit.english import ABOUT_OTHERS
from f4x_core.edit.language import MAX_CHARACTERS, Refusal, about_there, nearest, parse
from f4x_core.edit.lengths import in_units
from f4x_core.edit.operations import Delete, Freeze, Opacity, Recolour, Retime, Transform, read_operation
from f4x_core.edit.request import Request
from f4x_core.edit.selects import Current, Ids, Instance, Named, Not, Or, Text
from f4x_core.errors import F4xError
from f4x_core.language.colour_names import COLOURS
from f4x_core.language.grammar import VOCABULARY

TABLE = json.loads(Path(__file__).with_name("phrases.json").read_text())
PHRASES = TABLE["phrases"]
CLIP = {"fps": 10, "frames": 60, "frame": 12}
DOG = Text(("dog",))


def say(sentence, *, selected=False, labels=TABLE["labels"], names=TABLE["names"], copies=None, **clip):
    return parse(Request(sentence, labels, names, selected=selected, **CLIP | clip), copies=copies)


def wanted(phrase):
    return tuple(read_operation(operation, phrase["say"]) for operation in phrase.get("ops", ()))


def understood(phrase):
    """The operations, () for a refusal."""
    try:
        return say(phrase["say"], selected=phrase.get("selected", False))
    except Refusal:
        return ()


def test_the_table_is_understood():
    wrong = [phrase["say"] for phrase in PHRASES if "ops" in phrase and understood(phrase) != wanted(phrase)]
    assert not wrong


def test_nothing_is_done_where_it_should_be_refused():
    refused = [phrase for phrase in PHRASES if "refuse" in phrase]
    assert {phrase["say"]: understood(phrase) for phrase in refused if understood(phrase)} == {}


def test_a_refusal_names_the_word_and_offers_commands():
    with pytest.raises(Refusal, match="no sound"):
        say("make the dog bark")
    with pytest.raises(Refusal) as message:
        say("freeze-o the dog at frame 20 chop chop")
    assert 1 <= len(message.value.nearest) <= 3
    assert all(say(example, labels=("dog", "car", "house")) for example in message.value.nearest)
    assert isinstance(message.value, F4xError)
    with pytest.raises(Refusal, match="did you mean 'delete'"):
        say("delte the dog")


def test_every_example_is_understood():
    for example in {command.example for command in COMMANDS if command.make not in ABOUT_OTHERS}:
        assert say(example), example


@pytest.mark.parametrize(
    ("sentence", "plan"),
    [
        ("make the dog a bit bigger", "make the dog 20 % bigger"),
        ("shrink the dog slightly", "make the dog 17 % smaller"),
        ("the dog should be bigger", "make the dog 50 % bigger"),
        ("make the dog half as big", "make the dog half as big"),
        ("make the dog twice as big", "make the dog twice as big"),
        ("make the dog three times as big", "scale the dog by 3"),
        ("brighten the dog a little", "make the dog 20 % brighter"),
        ("make the dog glow", "make the dog glow by 50 %"),
        ("add a soft red glow around the dog", "make the dog glow red by 25 %"),
        ("let the dog glow strongly from second 1 to 2", "make the dog glow by 100 % from frame 10 to frame 20"),
        ("make the dog glow at 80 %", "make the dog glow by 80 %"),
        ("blur the dog", "blur the dog by 0.02 units"),
        ("blur the dog a bit until second 2", "blur the dog by 0.01 units from frame 0 to frame 20"),
        ("tint the dog red", "make the dog 50 % red"),
        ("make the dog 30 % blue", "make the dog 30 % blue"),
        ("make the dog redder", "make the dog 30 % more red"),
        ("make the dog a bit greener", "make the dog 15 % more green"),
        ("make the dog look a bit like gold", "make the dog look 50 % like gold"),
    ],
)
def test_a_plan_says_how_much_and_is_read_as_itself(sentence, plan):
    made = say(sentence)
    assert in_words(made) == plan and say(plan) == made


def test_words_of_an_operation_mean_it():
    described = {describe(operation): operation for phrase in PHRASES for operation in wanted(phrase)}
    assert len(described) > 150
    for words, operation in described.items():
        others = isinstance(operation, Delete) and isinstance(operation.select, Not)
        if not others or words == "remove the background":  # else an extraction, or "else" needs a sentence before it
            assert say(words, selected=True, names=["rex", "fido", "copy", "twin"]) == (operation,), words


def test_words_that_are_no_sentence_are_still_words():
    message = describe(
        Transform(Current(), translate=(1, 2, 3), rotate=(0, 0, 5), pivot=(0, 0, 1), frames=(0, 3), ease="linear")
    )
    assert message == (
        "move the selection by (1, 2, 3) units along the scene's own axes and rotate the selection by (0, 0, 5) degrees"
        " about the scene's own axes from frame 0 to frame 3 evenly"
    )
    assert describe(Recolour(DOG, (0.1234, 0, 0))) == "make the dog solid rgb 0.1234, 0, 0"


def test_it_is_the_last_thing_named_then_what_is_selected():
    assert say("make it red", selected=True)[0].select == Current()
    assert say("hide the cat and delete it", selected=True)[1].select == Text(("cat",))
    assert say("make the dog red and the cat blue, then delete them")[2].select == Text(("dog", "cat"))
    with pytest.raises(Refusal, match="named or selected"):
        say("make it red")


@pytest.mark.parametrize("left", ["the left one", "the left dog", "the leftmost of the dogs"])
def test_of_a_thing_and_its_copy_there_is_a_left_one(left):
    copied, painted = say(f"copy the dog to the left and make {left} red")
    assert copied.name == "copy" and painted.select == Instance(Or((DOG, Named("copy"))), "left", 12)
    assert say("copy the dog to the left, then copy it up and make the copy red")[2].select == Named("copy 2")


def test_the_copy_gets_a_name_by_which_it_is_selected():
    copied, painted = say("copy the dog and make the copy red")
    assert (copied.name, painted.select) == ("copy", Named("copy"))
    copied, painted = say("copy the dog and make it red")
    assert describe(copied).endswith("called copy") and describe(painted) == "make the copy red"
    assert say("copy the dog and make the dog red") == (replace(copied, name=""), replace(painted, select=DOG))
    with pytest.raises(Refusal, match="No copy"):
        say("make the copy red")


@pytest.mark.parametrize(
    "sentence", ["make the dog red and blue", "make the dog bigger and smaller", "move the dog left and right"]
)
def test_what_excludes_one_another_is_refused(sentence):
    with pytest.raises(Refusal, match=r"exclude one another|on one line"):
        say(sentence)


def test_the_present_frame_decides_who_is_left():
    assert say("hide the left dog", frame=33.4)[0].select.frame == 33
    assert say("hide the left dog of frame 5")[0].select.frame == 5
    with pytest.raises(Refusal, match="none of the clip's"):
        say("hide the left dog of frame 60")


def test_a_time_in_front_holds_until_the_next_sentence():
    first, second, third = say("from second 2 make the dog red and hide the cat. Delete the car")
    assert first.frames == second.frames == (20, None)
    assert third.frames is None


def test_times_outside_the_clip_are_refused():
    assert say("make the dog red from second 4 to 6")[0].frames == (40, 59)  # the instant at which the clip ends
    for late, missing in {
        "from second 6": "second 6",
        "at frame 60": "frame 60",
        "until frame 61": "frame 61",
        "in the last 7 seconds": "second -1.",
    }.items():
        with pytest.raises(Refusal, match=rf"There is no {missing}\S*: the clip lasts 6.00 seconds, frames 0 to 59"):
            say(f"make the dog red {late}")


def test_a_freeze_without_time_is_now():
    assert say("freeze the dog", frame=33.5) == (Freeze(DOG, at=33.5),)


def test_without_labels_any_noun_is_a_thing():
    assert say("make the zebra red", labels=())[0].select == Text(("zebra",))
    assert say("hide zebras and lions", labels=())[0].select == Text(("zebra", "lion"))


def test_labels_are_found_as_they_are_spelled():
    assert say("hide the fire-hydrants", labels=("Fire Hydrant",))[0].select == Text(("Fire Hydrant",))
    assert say("hide the GRAY wolves", labels=("grey wolf",))[0].select == Text(("grey wolf",))


def test_lexicons_agree_with_the_other_rooms():
    assert COLOURS["rebeccapurple"] == (0.4, 0.2, 0.6)
    assert len(COLOURS) > 148
    for look in styles.STYLES:
        assert say(f"make the dog look like {look}")[0].look == look
    assert say("show the dog again")[0].factor == SHOWN


WORDS = st.sampled_from(
    sorted(VOCABULARY | {"dog", "cat", "red", "7", "0.5", "#ff0000", "rex", "it", ",", ".", "?", '"', "'s"})
)


@settings(max_examples=100, deadline=None)
@given(st.one_of(st.text(max_size=100), st.lists(WORDS, max_size=12).map(" ".join)), st.booleans())
def test_any_text_gives_operations_or_a_refusal(text, selected):
    try:
        operations = say(text, selected=selected)
    except Refusal as refusal:
        assert refusal.reason
    else:
        assert operations
        assert all(read_operation(json.loads(json.dumps(o.to_json()))) == o for o in operations)


@pytest.mark.parametrize(
    "part",
    [
        "make the dog red and ",
        "and ",
        "remove the dog and the cat, ",
        "left and up and ",
        "x",
        "\n",
        "from second 2 to 4 ",
    ],
)
def test_long_texts_take_bounded_time(part):
    """Three times the text takes 27 times as long at most, on any machine; what is too long is refused without being read."""
    took = []
    for length in (MAX_CHARACTERS // 3, MAX_CHARACTERS, 10_000):
        text, start = (part * length)[:length], time.process_time()
        with suppress(Refusal):
            say(text)
        took.append(max(time.process_time() - start, 0.02))  # less is the clock's own grain
    assert took[1] < 27 * took[0] and took[2] < 2 * took[1]


@pytest.mark.parametrize(
    ("sentence", "word"),
    [
        ("make the dog not red", "'not'"),
        ("don't remove the dog", "'don't'"),
        ("undo the last two edits", "`f4x undo SCENE`"),
        ("scale the scene to meters", "Scale to Length"),
        ("align it to the floor", "Align to Floor"),
        ("relight the scene", "as it was filmed"),
    ],
)
def test_the_word_that_is_blamed_is_the_one_at_fault(sentence, word):
    with pytest.raises(Refusal) as message:
        say(sentence, selected=True)
    assert word in message.value.reason
    assert not any("remove" in example for example in message.value.nearest if "n't" in sentence)


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("move it 10cm up", "move it 0.05 units up"),
        ("move it half a meter up by 2 feet", "move it 0.25 units up by 0.3048 units"),
        ("remove the two feet in 2 seconds", "remove the two feet in 2 seconds"),
        ("paint a foot red", "paint a foot red"),
    ],
)
def test_lengths_are_units_of_a_scene_that_is_known_to_be_so_large(sentence, expected):
    assert in_units(sentence, 2.0) == expected


@pytest.mark.parametrize(
    "sentence", ["play the dog at half speed during the first second", "slow motion for the dog until second 1"]
)
def test_a_speed_during_a_part_is_for_what_is_shown_then(sentence):
    assert say(sentence) == (Retime(DOG, 0.5, (0.0, 10.0)),)


@pytest.mark.parametrize(
    ("sentence", "plan"),
    [
        ("hide the drift car", "hide the drift car"),
        ("make the jump dog bigger", "make the jump dog 50 % bigger"),
        ("move the show dog up", "move the show dog by 1 width up"),
        ("freeze the dance dog at second 1", "freeze the dance dog at frame 10"),
        ("turn the tow car around", "rotate the tow car by 180 degrees to the right"),
        ("speed up the race car from second 1 to 2", "play the race car at 150 % speed from frame 10 to frame 20"),
        ("make the guide dog red and the police car blue", "make the guide dog red; make the police car blue"),
    ],
)
def test_a_verb_or_noun_before_a_thing_says_which_kind_it_is(sentence, plan):
    assert in_words(say(sentence)) == plan


def test_examples_are_about_what_is_there():
    """None removes, whatever is said, and each can be carried out."""
    for sentence in ("make the sky pink", "remove the sky", "hide it all", "keep only it", "match the water"):
        found = nearest(sentence, ("swan", "water"))
        assert not any(
            word in " ".join(found).split() for word in ("sky", "dog", "car", "remove", "hide", "delete", "keep")
        )
        assert all(say(example, labels=("swan", "water")) for example in found)
    assert "make the swan red" in nearest("make the sky pink", ("swan", "water"))
    assert "make the swan red" not in nearest("make the swan red", ("swan", "water"))  # it was just refused


def test_examples_of_a_refusal_speak_of_what_is_there():
    reason = "Say for example 'swap the dog and the cat', or 'raise the bird'; 'the bird' is not there."
    told = about_there(reason, "the bird up", ("swan", "reed"))
    assert told == "Say for example 'swap the swan and the reed', or 'raise the bird'; 'the bird' is not there."
    assert about_there("say 'swap the dog and the cat'", "swap", ("swan",)) == "say 'swap the dog and the cat'"


def test_degrees_are_ordered():
    degrees = ("a tiny bit", "a little", "", "much", "a lot")
    for sentence, value in (
        ("make the dog {} bigger", lambda one: one.scale),
        ("make the dog {} brighter", lambda one: one.rgb[0]),
        ("make the dog {} more transparent", lambda one: -one.factor),
        ("move the dog {} to the left", lambda one: -one.translate[0]),
        ("blur the dog {}", lambda one: one.radius),
        ("turn the dog {} to the left", lambda one: -one.rotate[1]),
        ("make the dog {} redder", lambda one: one.rgb[0]),
    ):
        found = [value(say(sentence.format(degree))[0]) for degree in degrees]
        assert found == sorted(set(found)), sentence
    strengths = [say(f"make the dog {degree} red")[0].strength for degree in ("a tiny bit", "a little", "")]
    assert strengths == sorted(set(strengths))


@pytest.mark.parametrize(
    ("sentence", "plan"),
    [
        ("make the dog more red by half", "make the dog 50 % more red"),
        ("freeze the dog at one and a quarter seconds", "freeze the dog at frame 12.5"),
        ("scale the dog down to a third of what it was", "scale the dog by 0.333"),
        ("move the dog a couple of widths up", "move the dog by 2 widths up"),
        ("make it bluer", "make everything 30 % more blue"),
    ],
)
def test_shares_stand_where_amounts_do(sentence, plan):
    assert in_words(say(sentence)) == plan


@pytest.mark.parametrize(
    ("sentence", "reason"),
    [
        ("cut the last two seconds", "keeps its length"),
        ("how many cars are there", "f4x ask"),
        ("is the dog bigger than the cat", "f4x ask"),
        ("how fast does the car go", "f4x ask"),
        ("go back to how it was", "f4x undo"),
        ("does the dog look big", "f4x ask"),
        ("keep only the first second", "keeps its length"),
        ("can the dog be as big as a house", "against one another"),
        ("shake the camera less", "--path stabilise"),
        ("dissolve to the next shot", "one shot"),
    ],
)
def test_what_cannot_be_is_refused_for_its_own_reason(sentence, reason):
    with pytest.raises(Refusal, match=reason):
        say(sentence)


@pytest.mark.parametrize(
    "sentence", ["remove shadow of dog", "remove shadow of the dog", "remove the shadow of the dog"]
)
def test_a_shadow_needs_no_article(sentence):
    assert in_words(parse(Request(sentence, ("dog",), fps=10.0, frames=30))) == "remove the dog's shadow"


def test_copies_of_earlier_sentences_are_the_copy():
    copies, one = Ids((7, 8), words="the copy"), replace(DOG, number="one")
    earlier = {copies: Ids((1, 2), words="the dog")}
    assert say("make the copy red", copies=earlier)[0].select == copies
    assert (
        say("hide the dog", copies=earlier)[0].select == one and say("hide the dogs", copies=earlier)[0].select == DOG
    )
    assert say("hide the left dog", copies=earlier)[0].select == Instance(DOG, "left", 12)
    with pytest.raises(Refusal, match="more than once"):
        say("make the copy red", copies=earlier | {Ids((9,)): DOG})


def test_both_wants_two():
    assert say("make both dogs red")[0].select == replace(DOG, number="both")
    assert say("make both of the dogs red")[0].select == replace(DOG, number="both")


def test_a_fade_in_ends_with_all_of_it():
    (fade,) = say("fade the dog in over the first second")
    assert fade == Opacity(DOG, 0.0, (0, 10), "linear", inward=True)
    assert say(describe(fade)) == (fade,)


def test_the_background_but_not_the_dog_is_told_so():
    message = "remove the background but not the dog"
    assert describe(say(message)[0]) == message


@pytest.mark.parametrize(
    "sentence",
    [
        "I would hate to see the car removed",
        "it would be wrong to remove the dog",
        "it would be a shame to lose the dog",
        "I'm afraid the dog will be removed",
        "nobody wants a red car here",
        "I doubt that the car should be red",
        "I wouldn't want a teal wash all over that car",
        "refrain from cutting out the dog",
        "the last thing I want is the car deleted",
    ],
)
def test_what_is_said_to_be_unwanted_is_not_done(sentence):
    with pytest.raises(Refusal):
        parse(Request(sentence, ["car", "dog"], fps=24, frames=72))
