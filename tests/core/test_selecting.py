"""Sentences that select, and refusals that offer nothing which removes."""

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.language import nearest
from f4x_core.edit.resolve import Absent, EditorState
from f4x_core.edit.selecting import read_selecting
from f4x_core.errors import F4xError
from f4x_core.query.selection import Selection

WALL, SQUARE = slice(0, 1120), slice(1120, 1201)


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.mark.parametrize(
    ("sentence", "mode", "wall", "square"),
    [
        ("select what moves", "SET", False, True),
        ("Select what stands still.", "SET", True, False),
        ("select the background", "SET", True, False),
        ("select the square", "SET", False, True),
        ("pick only the square", "SET", False, True),
        ("select everything", "SET", True, True),
        ("select everything but the square", "SET", True, False),
        ("select nothing", "SET", False, False),
        ("deselect all", "SET", False, False),
        ("clear the selection", "SET", False, False),
        ("also select the square", "ADD", False, True),
        ("add the square to the selection", "ADD", False, True),
        ("deselect the square", "SUBTRACT", False, True),
        ("remove the square from the selection", "SUBTRACT", False, True),
    ],
)
def test_what_a_sentence_selects(scene, sentence, mode, wall, square):
    found = read_selecting(scene, sentence)
    expected = np.zeros(1201, bool)
    expected[WALL], expected[SQUARE] = wall, square
    assert found is not None and found.mode == mode
    np.testing.assert_array_equal(found.chosen, expected)


@pytest.mark.parametrize(
    "sentence",
    [
        "make the square red",
        "select the square and make it red",
        "remove the square",
        "what moves?",
        "highlight red",
        "",
    ],
)
def test_other_sentences_are_left_to_the_edits(scene, sentence):
    assert read_selecting(scene, sentence) is None


def test_it_is_what_is_selected(scene):
    marks = np.zeros(1201)
    marks[SQUARE] = 1
    held = Selection(scene.ids, marks, np.zeros(1201, bool))
    found = read_selecting(scene, "select everything but it", EditorState(held))
    assert found is not None and found.chosen[WALL].all() and not found.chosen[SQUARE].any()


def test_a_thing_that_is_not_there_is_explained(scene):
    with pytest.raises(F4xError, match="lacks 'goat'"):
        read_selecting(scene, "select the goat")
    with pytest.raises(Absent, match="only one of"):
        read_selecting(scene, "select both squares")


@pytest.mark.parametrize(
    "sentence",
    [
        "frobnicate the scene",
        "light the scene from the left",
        "refurbish the wall",
        "delete the frob",
        "erasing the frob",
        "obliterify and delete the wall somehowly",
    ],
)
def test_a_refusal_offers_no_removal(sentence):
    assert not any(
        one.startswith(("remove", "delete", "hide", "keep")) for one in nearest(sentence, ("wall", "square"))
    )
