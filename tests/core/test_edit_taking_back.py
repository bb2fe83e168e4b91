"""Sentences that take a change away or lessen it are never answered with what makes it."""

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.cli import main
from f4x_core.edit.bake import bake
from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.operations import (
    Blur,
    Duplicate,
    Freeze,
    Glow,
    Loop,
    Recolour,
    Retime,
    Reverse,
    Style,
    TakeBack,
    Transform,
)
from f4x_core.edit.plan import preview, propose
from f4x_core.edit.request import Request
from f4x_core.edit.stack import of, read_stack
from f4x_core.edit.taking_back import TakenBack
from f4x_core.errors import F4xError
from f4x_core.language.grammar import Doubt
from f4x_core.scene import write_scene

LABELS = ("dog", "car", "horse", "tree")


def say(sentence):
    return parse(Request(sentence, LABELS, fps=24.0, frames=72))


@pytest.mark.parametrize(
    ("made", "sentences"),
    [
        (
            Glow,
            "remove the glow from the horse|stop the dog glowing|no more glow on the horse|turn off the glow of the car|"
            "the dog should no longer glow|let the tree stop shining|the horse without its halo|less glow on the dog|"
            "the glow of the car is too strong|make the glow go away|deglow the horse|I find the glow on the dog ugly",
        ),
        (
            Blur,
            "take the blur off the dog|stop blurring the car|un-blur the dog|unblur the tree|the dog is too blurry|"
            "make the horse less blurry|lose the blur on the car|reduce the blur of the dog|the tree shouldn't be blurred any more",
        ),
        (
            Recolour,
            "undo the tint of the car|the car should no longer be red|give the dog its color back|untint the horse",
        ),
        (
            Style,
            "remove the gold look from the car|no more silver look on the dog|take the sunset filter off everything",
        ),
        (
            Freeze,
            "unfreeze the dog|stop freezing the horse|the car should stop being frozen|remove the freeze of the dog",
        ),
        (
            Retime,
            "remove the slow motion from the dog|no more slow motion|the horse at normal speed again|speed the car up less",
        ),
        (Loop, "stop looping the dog|undo the loop of the horse"),
        (Reverse, "stop reversing the car|un-reverse the dog"),
        (Duplicate, "remove the trail behind the dog|no more ghosts behind the horse|remove the copy of the car"),
        (
            Transform,
            "stop enlarging the dog|quit rotating the car already|I'd like a lot less rotation on the tree|"
            "there is far too much enlargement on the horse|the shrinking on the dog has to go",
        ),
        (
            Recolour,
            "quit brightening the dog|stop darkening the tree|the red tint on the horse must go|stop saturating the car",
        ),
        (Glow, "the glow on the tree has to go|the halo around the dog should go"),
        (Blur, "the blur on the car needs to go"),
    ],
)
def test_taking_a_change_back_is_never_a_proposal_of_it(made, sentences):
    for sentence in sentences.split("|"):
        with pytest.raises(Refusal) as refused:
            say(sentence)
        assert isinstance(refused.value, TakenBack), sentence
        assert made in refused.value.kinds, sentence
        assert "`f4x undo SCENE`" in refused.value.reason and not refused.value.nearest


@pytest.mark.parametrize(
    ("sentence", "plan"),
    [
        ("un-hide the dog", "show the dog again"),
        ("make the dog less dark", "make the dog 50 % brighter"),
        ("stop showing the dog", "hide the dog"),
        ("make the dog visible again", "show the dog again"),
        ("de-saturate the dog", "make the dog black and white"),
        ("dial the contrast of the dog back", "set the contrast of the dog to 67 %"),
        ("remove the dog and make the horse glow", "remove the dog; make the horse glow by 50 %"),
        ("remove the glowing dog", "remove the glowing dog"),
        ("the horse has to go", "remove the horse"),
        ("the car must go faster", "play the car at 150 % speed"),
        ("the tree should go blue", "make the tree blue"),
        ("stop the dog from moving", "freeze the dog at frame 0"),
    ],
)
def test_what_an_operation_does_is_still_done(sentence, plan):
    assert "; ".join(map(describe, say(sentence))) == plan


@pytest.mark.parametrize(
    "sentence", ["get the darkness off that dog", "get the grayness off the car", "peel the gloom from the horse"]
)
def test_what_is_to_come_off_a_thing_does_not_remove_the_thing(sentence):
    with pytest.raises(Refusal) as refused:
        say(sentence)
    assert "remove" not in getattr(refused.value, "instead", "")


@pytest.mark.parametrize(
    "sentence", ["undelete the dog", "unfreeze the car", "unpaint the horse", "un-delete the tree"]
)
def test_a_word_that_turns_another_round_is_no_slip_of_it(sentence):
    with pytest.raises(Refusal) as refused:
        say(sentence)
    assert not isinstance(refused.value, Doubt) and "did you mean" not in refused.value.reason


def taken(scene, sentence):
    """What a sentence takes back, in words."""
    (operation,) = propose(scene, sentence).chosen.operations
    assert isinstance(operation, TakeBack)
    return operation.words


def refused(scene, sentence):
    with pytest.raises(Refusal) as message:
        propose(scene, sentence)
    return message.value.reason


@pytest.fixture(scope="module")
def scene():
    made = labelled_scene()
    for sentence in ("make the square glow", "blur the wall", "make the wall red"):
        made = preview(made, propose(made, sentence).chosen)
    return made


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("stop the square glowing", "make the square glow by 50 %"),
        ("no more glow", "make the square glow by 50 %"),
        ("the glow on the square has to go", "make the square glow by 50 %"),
        ("unblur the wall", "blur the wall by 0.02 units"),
        ("take the blur off the wall", "blur the wall by 0.02 units"),
        ("undo the tint of the wall", "make the wall red"),
        ("the wall should no longer be red", "make the wall red"),
        ("give the wall its color back", "make the wall red"),
    ],
)
def test_the_edit_that_made_the_change_is_taken_back(scene, sentence, words):
    assert taken(scene, sentence) == words
    after = preview(scene, propose(scene, sentence).chosen)
    assert [describe(one.operation) for one in of(after).edits if not one.enabled] == [words]
    assert "No edit of this scene made" in refused(after, sentence)  # it is gone


def test_what_was_taken_back_is_as_it_never_was_and_comes_back_by_undoing(scene):
    without = labelled_scene()
    for sentence in ("blur the wall", "make the wall red"):
        without = preview(without, propose(without, sentence).chosen)
    after = preview(scene, propose(scene, "remove the glow from the square").chosen)
    shown, wanted = after.posed(2.0), without.posed(2.0)
    there = shown.opacities > 0
    for name in ("means", "opacities", "sh", "scales"):
        np.testing.assert_array_equal(getattr(shown, name)[there], getattr(wanted, name)[wanted.opacities > 0])
    stack = of(after)
    assert stack.undo().edits == of(scene).edits
    assert stack.undo().redo().edits == stack.edits
    last = stack.edits[-1].id
    assert all(edit.enabled for edit in stack.remove(last).edits)  # in the panel's list
    assert [edit.enabled for edit in stack.enable(last, False).edits] == [True, True, True, False]
    assert stack.enable(last, False).enable(last, True) == stack
    assert len(of(bake(after)).edits) == len(of(bake(without)).edits)
    with pytest.raises(F4xError, match="switched off already"):
        stack.append(stack.edits[-1].operation)
    with pytest.raises(F4xError, match="there is no edit 9"):
        stack.append(TakeBack(9))


def test_where_no_edit_or_more_than_one_may_be_meant_that_is_told(scene):
    assert "No edit of this scene made 'glow' for 'wall'" in refused(scene, "remove the glow from the wall")
    assert "No edit of this scene made 'freezing'" in refused(scene, "stop freezing the square")
    assert "'make the square glow by 50 %' is there as it was said" in refused(scene, "less glow on the square")
    twice = preview(scene, propose(scene, "make the square glow red").chosen)
    assert "More than one edit may be meant: 'make the square glow by 50 %', 'make" in refused(twice, "no more glow")


def test_taking_back_in_the_terminal(capsys, tmp_path):
    path = str(tmp_path / "a.f4x")
    write_scene(labelled_scene(), path)
    for sentence in ("make the square glow", "make the wall red", "remove the glow from the square"):
        assert main(["edit", path, "--say", sentence]) == 0
    assert (
        "3 take back 'make the square glow by 50 %'\n" in (said := capsys.readouterr().out)
        and ": 1 edit in effect" in said
    )
    assert main(["history", path]) == 0
    assert '1 make the square glow by 50 % ("make the square glow") [off]' in capsys.readouterr().out
    assert main(["undo", path]) == 0 and all(edit.enabled for edit in read_stack(path).edits)
