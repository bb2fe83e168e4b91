"""The stack as a value: every change has an inverse, JSON is strict, merge is exact, files are untouched."""

import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scene import random_scene

from f4x_core.edit.operations import Delete, Freeze, Name, Opacity, Recolour, Style, TakeBack, Transform
from f4x_core.edit.selects import All, Ids, Moving, Not
from f4x_core.edit.stack import (
    MAX_EDITS,
    UNDONE,
    Edit,
    EditStack,
    merge,
    of,
    read_stack,
    redo,
    undo,
    with_stack,
    write_stack,
)
from f4x_core.errors import F4xError
from f4x_core.scene import write_scene

OPERATIONS = (
    Delete(Moving()),
    Opacity(All(), 0.5, frames=(1.0, 3.0)),
    Recolour(Ids.of(np.arange(7)), (1.0, 0.0, 0.25), "hue"),
    Transform(Not(Moving()), rotate=(0.0, 30.0, 0.0), pivot=(0.0, 0.0, 2.0)),
    Style(Moving(), "gold", 0.5),
    Freeze(Moving(), 2.0, 3.0),
    Name(Moving(), "rex"),
)


def stack_of(*operations):
    stack = EditStack()
    for operation in operations:
        stack = stack.append(operation)
    return stack


@st.composite
def stacks(draw, least=0):
    """A stack after some appends, undos and redos."""
    stack = stack_of(*draw(st.lists(st.sampled_from(OPERATIONS), min_size=least, max_size=8)))
    for _ in range(draw(st.integers(0, max(len(stack) - least, 0)))):
        stack = stack.undo()
    return stack


@settings(max_examples=60, deadline=None)
@given(stacks(least=1), st.data())
def test_every_change_has_an_exact_inverse(stack, data):
    edit = data.draw(st.sampled_from(stack.edits))
    at, to = stack.position(edit.id), data.draw(st.integers(0, len(stack) - 1))
    other = data.draw(st.sampled_from(OPERATIONS))
    assert stack.remove(edit.id).insert(edit, at) == stack
    assert stack.move(edit.id, to).move(edit.id, at) == stack
    assert stack.replace(edit.id, other).replace(edit.id, edit.operation) == stack
    assert stack.enable(edit.id, False).enable(edit.id, True) == stack
    assert stack.undo().redo() == stack
    assert stack.append(other).undo().edits == stack.edits
    if stack.undone:
        assert stack.redo().undo() == stack


@settings(max_examples=40, deadline=None)
@given(stacks())
def test_json_round_trip(stack):
    scene = with_stack(random_scene(dynamic=0), stack)
    text = json.dumps({"edits": scene.edits, UNDONE: scene.extra_fields.get(UNDONE, [])})
    again = json.loads(text)
    back = replace(scene, edits=tuple(again["edits"]), extra_fields={UNDONE: again[UNDONE]})
    assert of(back) == stack


def test_said_and_enabled_are_kept_and_new_ids_are_new():
    stack = EditStack().append(OPERATIONS[0], "take the dog out").append(OPERATIONS[1]).enable(1, False)
    assert stack.to_json()[0] == {"op": "delete", "select": {"by": "moving"}, "id": 1, "enabled": False,
                                  "said": "take the dog out"}  # fmt: skip
    assert "enabled" not in stack.to_json()[1] and "said" not in stack.to_json()[1]
    assert stack.undo().append(OPERATIONS[2]).edits[-1].id == 3  # not that of the undone one
    assert stack.undo().append(OPERATIONS[2]).undone == ()


def test_merge_takes_both_sides():
    base = stack_of(*OPERATIONS[:3])
    ours = base.replace(1, OPERATIONS[4]).append(OPERATIONS[5], "ours")
    theirs = base.enable(3, False).remove(2).append(OPERATIONS[6], "theirs")
    merged = merge(base, ours, theirs)
    assert [(e.id, e.operation, e.enabled, e.sentence) for e in merged.edits] == [
        (1, OPERATIONS[4], True, ""),
        (3, OPERATIONS[2], False, ""),
        (4, OPERATIONS[5], True, "ours"),
        (5, OPERATIONS[6], True, "theirs"),
    ]
    assert merge(base, ours, base).edits == ours.edits
    assert merge(base, base, theirs).edits == theirs.edits
    assert merge(base, ours, ours).edits == ours.edits
    assert merge(base, base, base.move(3, 0)).edits == base.move(3, 0).edits
    assert merge(base, base.move(1, 2), base.move(3, 0)).edits == base.move(1, 2).edits


@pytest.mark.parametrize(
    ("ours", "theirs", "told"),
    [
        (lambda s: s.replace(2, OPERATIONS[4]), lambda s: s.enable(2, False), "edit 2 (opacity): both changed it"),
        (lambda s: s.remove(2), lambda s: s.enable(2, False), "edit 2 (opacity): one side removed it"),
    ],
)
def test_merge_names_a_conflict(ours, theirs, told):
    base = stack_of(*OPERATIONS[:3])
    with pytest.raises(F4xError, match=re.escape(told)):
        merge(base, ours(base), theirs(base))


def test_what_is_not_there_is_told():
    stack = stack_of(OPERATIONS[0])
    for change in (lambda: stack.remove(7), lambda: EditStack().undo(), lambda: stack.redo(), lambda: stack.move(1, 9)):
        with pytest.raises(F4xError, match=r"no edit 7|nothing to|no place"):
            change()
    with pytest.raises(F4xError, match=f"{MAX_EDITS} are the most"):
        EditStack(tuple(Edit(OPERATIONS[0], i + 1) for i in range(MAX_EDITS + 1)))
    with pytest.raises(F4xError, match="id 1 occurs twice"):
        EditStack((stack.edits[0], stack.edits[0]))


def sha(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_undone_and_forgotten_edits_leave_the_same_bytes(tmp_path):
    path = tmp_path / "a.f4x"
    write_scene(random_scene(extra_fields={"kept": None, "note": "by another program"}), path)
    before = sha(path)
    stack = stack_of(*OPERATIONS)
    write_stack(path, stack)
    edited = sha(path)
    assert read_stack(path) == stack
    for count in (1, 3):
        undo(path, count)
    assert [edit.id for edit in read_stack(path).undone] == [7, 6, 5, 4]
    redo(path, 4)
    assert sha(path) == edited
    undo(path, len(stack))
    assert sha(path) != before  # what redo brings back is there
    write_stack(path, replace(read_stack(path), undone=()))
    assert sha(path) == before


def test_more_steps_than_there_are_take_all(tmp_path):
    path = tmp_path / "a.f4x"
    write_scene(with_stack(random_scene(), stack_of(*OPERATIONS[:2])), path)
    assert len(undo(path, 3)) == 0 and len(redo(path, 99)) == 2


def test_steps_that_cannot_be_taken_change_nothing(tmp_path):
    path = tmp_path / "a.f4x"
    write_scene(with_stack(random_scene(), stack_of(*OPERATIONS[:2])), path)
    before = sha(path)
    for step, count in ((redo, 1), (undo, 0)):
        with pytest.raises(F4xError, match=re.escape(str(path))):
            step(path, count)
    assert sha(path) == before


GOOD = {"op": "delete", "select": {"by": "moving"}, "id": 1}


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({**GOOD, "op": "explode"}, "no op"),
        ({**GOOD, "op": ["delete"]}, "no op"),
        ({k: v for k, v in GOOD.items() if k != "id"}, "whole number id"),
        ({**GOOD, "id": True}, "whole number id"),
        ({**GOOD, "id": 0}, "number edits from 1"),
        ({**GOOD, "enabled": 1}, "enabled is true or false"),
        ({**GOOD, "said": ["x"]}, "said is text"),
        ({**GOOD, "said": "x" * 5000}, "letters"),
        ({**GOOD, "slect": {}}, "near it is 'select'"),
        ({**GOOD, "select": {"by": "ids", "ids": [1.5]}}, "whole number"),
        ({**GOOD, "select": {"by": "ids", "packed": "!!"}}, "base64"),
        ({**GOOD, "frames": [4, 1]}, "end before they start"),
        ({**GOOD, "frames": [1e9, None]}, "up to 1e\\+06"),
        ({"op": "style", "select": {"by": "all"}, "look": "golt", "id": 1}, "near it is 'gold'"),
        ({"op": "transform", "select": {"by": "all"}, "translate": [1e300, 0, 0], "id": 1}, "translate holds"),
        ({"op": "transform", "select": {"by": "all"}, "scale": float("nan"), "id": 1}, "scale"),
        ({"op": "duplicate", "select": {"by": "all"}, "first_id": 1 << 70, "id": 1}, "first_id is"),
        ({"op": "name", "select": {"by": "all"}, "name": "../x", "id": 1}, "letters, digits"),
    ],
)
def test_hostile_entries_are_one_sentence(entry, told):
    with pytest.raises(F4xError, match=told) as caught:
        of(random_scene(dynamic=0, edits=(entry,), name="s"))
    assert str(caught.value).startswith("s: edit 1") and "\n" not in str(caught.value)


def test_deeply_nested_selections_are_refused():
    select = {"by": "all"}
    for _ in range(5000):
        select = {"by": "not", "of": select}
    with pytest.raises(F4xError, match="inside one another"):
        of(random_scene(dynamic=0, edits=({**GOOD, "select": select},)))
    with pytest.raises(F4xError, match="no list"):
        of(random_scene(dynamic=0, extra_fields={UNDONE: {"a": 1}}))


def test_edits_in_effect_are_neither_taken_back_nor_what_takes_them_back():
    stack = stack_of(*OPERATIONS[:2])
    assert stack.in_effect == stack.edits
    taken = stack.append(TakeBack(2)).append(TakeBack(1))
    assert taken.in_effect == () and len(taken) == 4
    assert [edit.id for edit in taken.undo().in_effect] == [1] and taken.undo().undo().in_effect == stack.edits
    assert taken.undo().redo().in_effect == ()
