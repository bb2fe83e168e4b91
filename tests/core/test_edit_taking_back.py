"""Sentences that take a change away or lessen it are never answered with what makes it."""

import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.apply import edited
from f4x_core.edit.description import describe
from f4x_core.edit.language import Refusal, parse
from f4x_core.edit.operations import Blur, Duplicate, Freeze, Glow, Loop, Recolour, Retime, Reverse, Style, Transform
from f4x_core.edit.plan import preview, propose
from f4x_core.edit.request import Request
from f4x_core.edit.taking_back import TakenBack
from f4x_core.language.grammar import Doubt

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


def told(scene, sentence):
    with pytest.raises(Refusal) as refused:
        propose(scene, sentence)
    return refused.value.reason


def test_the_edit_to_take_back_is_named():
    scene = edited(labelled_scene())
    for sentence in ("make the square glow", "blur the wall", "make the wall red"):
        scene = preview(scene, propose(scene, sentence).chosen)
    assert "Take back edit 1, 'make the square glow by 50 %'" in told(scene, "stop the square glowing")
    assert "--count 3`" in told(scene, "stop the square glowing") and "with what came after it" in told(
        scene, "no more glow"
    )
    assert "Take back edit 2, 'blur the wall by 0.02 units'" in told(scene, "unblur the wall")
    assert (
        told(scene, "undo the tint of the wall")
        == "Take back the last edit, 'make the wall red': `f4x undo SCENE`, or the button for it."
    )
    assert "No edit of this scene made 'glow' for 'wall'" in told(scene, "remove the glow from the wall")
    assert "No edit of this scene made 'freezing'" in told(scene, "stop freezing the square")
