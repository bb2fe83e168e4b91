"""Sentences by what they do to the Gaussians of made-up scenes whose true objects are known."""

import re
from dataclasses import replace

import effects
import numpy as np
import pytest
from effect_scenes import FRAMES, effect_scene

from f4x_core.edit import plan
from f4x_core.edit.apply import with_operations
from f4x_core.edit.operations import Transform
from f4x_core.edit.plan_lines import plan_lines
from f4x_core.edit.resolve import EditorState
from f4x_core.edit.selects import Ids
from f4x_core.edit.stack import of
from f4x_core.language.refusal import Refusal
from f4x_core.query.questions import answer
from f4x_core.query.selection import Selection, fingerprint

OPEN, SEALED = effects.read(effects.EFFECTS), effects.read(effects.SEALED)


@pytest.mark.parametrize("scene", ["street", "crowd", "room"])
def test_sentences_do_what_is_said(scene):
    rows = [row for row in OPEN if row[0] == scene]
    assert {row[2]: why for row in rows if (why := effects.fault(row))} == {}


@pytest.mark.slow
def test_so_many_sealed_sentences_do_what_is_said():
    """They are counted and not listed, so that nobody mends the language for them."""
    assert len(SEALED) >= 100
    assert sum(not effects.fault(row) for row in SEALED) >= 120


def test_a_plan_counts_things_and_tells_how_much_of_the_scene_they_are():
    scene, things = effect_scene("street")
    (operation,) = plan.propose(scene, "remove both men").chosen.operations
    (line,) = plan_lines(scene, [operation])
    share = (things["man1"] | things["man2"]).mean()
    assert line == f"remove the 2 men ({100 * share:.0f} % of the scene's Gaussians)"
    (moved,) = plan.propose(scene, "move the ball to the left").chosen.operations
    assert "axes" not in next(plan_lines(scene, [moved]))


@pytest.mark.parametrize(
    "sentence", ["remove the man", "hide the man", "keep only the man", "remove the tree and the man"]
)
def test_every_command_that_a_question_offers_removes_another_choice(sentence):
    scene, things = effect_scene("street")
    with pytest.raises(Refusal, match="There are 2 men") as asked:
        plan.propose(scene, sentence)
    assert len(asked.value.nearest) == 3
    gone = set()
    for command in asked.value.nearest:
        after = plan.preview(scene, plan.propose(scene, command).chosen).posed(0.0).opacities
        gone.add(tuple(name for name, rows in things.items() if not after[rows].any()))
    assert len(gone) == 3


def test_how_tall_tells_each_of_several_and_what_is_not_known():
    said = answer(effect_scene("street")[0], "how tall is the man").text
    assert "each of 2 from left to right, 0.70 and 0.80 tall" in said and "no metres" in said
    assert "0.24 tall" in answer(effect_scene("street")[0], "how tall is the car").text


@pytest.mark.parametrize(
    ("question", "told"),
    [
        ("how big is the left man?", "^The left man is 0.70 tall"),
        ("which color is the biggest man?", "^The biggest man is green"),
        ("is the right man bigger than the left man?", "^Yes: the right man is 1.2 times"),
        ("where is the farthest man?", "^The farthest man is on the right"),
        ("how many dogs and cats are there?", "^Dog: 1 separate .* Nothing in the scene answers to 'cat'"),
        ("count the men and the dogs", "^Man: 2 separate .* Dog: 1 separate"),
        ("when does the dog leap?", "^The dog does not jump"),
    ],
)
def test_questions_tell_one_of_several_count_each_kind_and_know_a_jump(question, told):
    assert re.search(told, answer(effect_scene("street")[0], question).text)


def test_what_goes_up_and_comes_down_jumps():
    scene, things = effect_scene("street")
    dog = Ids.of(scene.ids[things["dog"]])
    up = with_operations(scene, Transform(dog, (0.0, -0.2, 0.0), frames=(8.0, 20.0)))
    assert "does not jump" in answer(up, "does the dog jump?").text  # it stays up there
    down = with_operations(up, Transform(dog, (0.0, 0.2, 0.0), frames=(20.0, 32.0)))
    assert re.search(
        "^Yes: the dog jumps by 0.20 .* highest at frame (19|20|21)", answer(down, "does the dog jump?").text
    )


def test_without_words_what_moves_is_a_thing_and_all_else_goes_by_gaussian():
    scene, things = effect_scene("street")
    chosen = Selection(scene.ids, things["dog"].astype(float), np.zeros(len(scene.ids), bool), scene=fingerprint(scene))
    after = plan.preview(
        scene := replace(scene, features=None),
        plan.propose(scene, "hide everything behind it", EditorState(chosen, 0.0)).chosen,
    ).posed(0.0)
    gone = {name: not after.opacities[rows].any() for name, rows in things.items()}
    assert gone["car"] and gone["wall"] and not gone["floor"] and not gone["ball"]


def test_an_exception_is_kept_whatever_it_is_of():
    scene, things = effect_scene("crowd")
    after = plan.preview(scene, plan.propose(scene, "hide the first person but leave their heads alone").chosen)
    gone = after.posed(0.0).opacities[things["p1"]] == 0
    head = scene.extra["dynamic/body_part"][things["p1"][len(scene.static) :]] == 1
    assert np.array_equal(gone, ~head)


@pytest.mark.parametrize(
    ("before", "why"),
    [
        ("hide the dog", "hides the dog"),
        ("make the dog invisible", "hides the dog"),
        ("keep only the car", "removed the dog"),
    ],
)
def test_of_what_is_no_longer_seen_it_is_said_why(before, why):
    scene, _ = effect_scene("street")
    edited = plan.preview(scene, plan.propose(scene, before).chosen)
    with pytest.raises(Refusal, match=f"an earlier edit {why}") as refusal:
        plan.propose(edited, "make the dog red")
    assert refusal.value.nearest == (("show the dog",) if "hides" in why else ())
    assert "n earlier edit hides or removed the dog" in answer(edited, "where is the dog?").text


@pytest.mark.parametrize(
    ("before", "sentence", "hidden"),
    [
        ("hide the dog from second 1 on", "make the dog blue from frame 30 on", True),
        ("hide the dog from second 1 on", "make the dog blue until frame 30", False),
        ("fade out the dog in the first second", "blur the dog from second 1.5 on", True),
        ("hide the dog from second 1 on", "show the dog", False),
    ],
)
def test_a_change_of_what_is_hidden_then_is_noted(before, sentence, hidden):
    scene, _ = effect_scene("street")
    edited = plan.preview(scene, plan.propose(scene, before).chosen)
    assert any("hidden by an earlier edit" in note for note in plan.propose(edited, sentence).notes) is hidden


def test_everything_said_before_is_taken_back():
    scene, _ = effect_scene("street")
    edited = scene
    for sentence in ("remove the ball", "make the car blue", "undo everything"):
        edited = plan.preview(edited, plan.propose(edited, sentence).chosen)
    before, after = scene.posed(0.0), edited.posed(0.0)
    assert np.array_equal(before.opacities, after.opacities) and np.array_equal(before.sh, after.sh)
    again = of(edited).undo()  # all of it is one edit
    assert [edit.in_effect for edit in again.edits] == [True, True]
    assert not any(edit.in_effect for edit in again.redo().edits)


def test_which_of_several_is_asked_in_a_frame_that_shows_them():
    scene, _ = effect_scene("street")
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = np.linspace(1.0, 0.0, FRAMES)  # the camera goes to the right, and shows the second man late
    scene = replace(scene, cameras=replace(scene.cameras, world_to_camera=poses))
    with pytest.raises(Refusal) as asked:
        plan.propose(scene, "remove the man")
    left = asked.value.nearest[0]
    frame = int(left.rpartition(" ")[2])
    assert left == f"remove the left man of frame {frame}" and frame > 0
    (operation,) = plan.propose(scene, "remove the left man").chosen.operations
    assert f"of frame {frame} " in next(plan_lines(scene, [operation]))


def test_how_many_people_there_are_is_not_known_where_neither_the_fit_nor_words_know_any():
    scene = replace(effect_scene("street")[0], features=None)
    assert "found no people" in answer(scene, "how many people are there?").text
    assert "2 separate" in answer(effect_scene("crowd")[0], "how many people are there?").text
