"""The verbs around edits, as a person runs them: files in, one sentence when something is wrong."""

import hashlib
import json

import numpy as np
import pytest
from labelled_scene import labelled_scene
from random_scene import random_scene

from f4x_core.cli.main import main
from f4x_core.edit.operations import Delete
from f4x_core.edit.selects import Ids, Moving, Named
from f4x_core.edit.stack import EditStack, read_stack, write_stack
from f4x_core.query.selection import Selection
from f4x_core.scene import read_scene, write_scene

OPERATIONS = [
    {"op": "recolour", "select": {"by": "moving"}, "rgb": [0, 1, 0]},
    {"op": "duplicate", "select": {"by": "moving"}, "offset": [0.3, 0, 0], "name": "twin"},
    {"op": "delete", "select": {"by": "named", "name": "twin"}, "frames": [3, None]},
]


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "a.f4x"
    write_scene(labelled_scene(), path)
    return path


@pytest.fixture
def operations(tmp_path):
    path = tmp_path / "ops.json"
    path.write_text(json.dumps(OPERATIONS))
    return path


def f4x(capsys, *arguments):
    """(exit code, JSON) of a command."""
    code = main([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def sha(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_edit_history_undo_redo_and_the_same_bytes_again(scene, operations, capsys):
    before = sha(scene)
    code, told = f4x(capsys, "edit", scene, "--ops", operations)
    assert code == 0 and [edit["id"] for edit in told["edits"]] == [1, 2, 3] and told["gaussians"] == [81, 81, 81]
    assert told["edits"][1]["first_id"] == labelled_scene().next_id
    code, told = f4x(capsys, "history", scene)
    assert [edit["op"] for edit in told["edits"]] == ["recolour", "duplicate", "delete"] and told["undone"] == []
    assert f4x(capsys, "undo", scene, "--count", 2) == (0, {"edits": 1, "undone": 2})
    assert f4x(capsys, "redo", scene) == (0, {"edits": 2, "undone": 1})
    assert f4x(capsys, "undo", scene, "--count", 99) == (0, {"edits": 0, "undone": 3})
    write_stack(scene, EditStack())
    assert sha(scene) == before


def test_an_edit_that_changes_no_gaussian_is_refused(scene, tmp_path, capsys):
    file, other = tmp_path / "ops.json", tmp_path / "other.f4x"
    hide = {"op": "opacity", "select": {"by": "moving"}, "factor": 0}
    file.write_text(json.dumps([hide]))
    assert main(["edit", str(scene), "--ops", str(file)]) == 0
    known = sha(scene)
    for neutral in (hide, {"op": "transform", "select": {"by": "moving"}}):
        file.write_text(json.dumps([neutral]))
        for more in ([], ["--dry-run"], ["-o", str(other)]):
            capsys.readouterr()
            assert main(["edit", str(scene), "--ops", str(file), *more]) == 2
            assert "leaves every Gaussian of the scene as it is, so nothing was written" in capsys.readouterr().err
    assert sha(scene) == known and not other.exists()
    assert main(["edit", str(scene), "--say", "call the wall rex"]) == 0  # a name need not change any


def test_what_is_faster_from_some_frame_on_changes_only_what_lies_between(scene, tmp_path):
    frames = len(read_scene(scene).cameras)
    file = tmp_path / "ops.json"
    faster = {"op": "retime", "select": {"by": "moving"}, "speed": 2.0, "frames": [frames // 2, None]}
    file.write_text(json.dumps([faster]))
    assert main(["edit", str(scene), "--ops", str(file)]) == 0


def test_undo_of_more_than_there_are_takes_all_back_and_says_so(scene, operations, capsys):
    f4x(capsys, "edit", scene, "--ops", operations)
    assert main(["undo", str(scene), "--count", "99"]) == 0
    assert "3 edits undone (there were no more, 99 were asked for); 0 edits in effect" in capsys.readouterr().out
    assert main(["undo", str(scene)]) == 2
    assert "nothing to undo" in capsys.readouterr().err


def test_history_numbers_the_edits_and_tells_them_in_words(scene, capsys):
    say = ["edit", str(scene), "--say"]
    for sentence in ("make the square red", "make everything darker", "copy the square to the left and move it up"):
        main([*say, sentence])
    main(["undo", str(scene), "--count", "3"])
    main([*say, "call the square rex"])
    capsys.readouterr()
    main(["history", str(scene)])
    assert capsys.readouterr().out.splitlines() == [
        "1 make the square red",
        '2 call the square "rex" ("call the square rex")',
    ]
    main(["undo", str(scene)])
    capsys.readouterr()
    main(["history", str(scene)])
    assert capsys.readouterr().out.splitlines()[1].startswith("2 call the square") and len(read_stack(scene)) == 1


def test_history_tells_ways_and_turns_as_the_camera_sees_them(scene, capsys):
    for sentence in (
        "move the square up by 2 widths",
        "rotate the square by 30 degrees",
        "copy the square to the left",
    ):
        main(["edit", str(scene), "--say", sentence])
    main(["undo", str(scene)])
    capsys.readouterr()
    main(["history", str(scene)])
    moved, turned, copied = capsys.readouterr().out.splitlines()
    assert moved.startswith("1 move the square by 2 widths up") and turned.startswith(
        "2 rotate the square by 30 degrees to the right"
    )
    assert copied.startswith("3 copy the square: the copy ends 1.2 widths to the left of it") and "axes" not in copied


def test_a_broken_edit_is_called_by_its_number_in_the_history(scene, capsys):
    stack = EditStack().append(Delete(Moving())).undo().append(Delete(Named("rex")))
    assert stack.edits[0].id == 2
    write_stack(scene, stack)
    assert main(["info", str(scene)]) == 2
    assert "edit 1 (delete): no selection before it is named 'rex'" in capsys.readouterr().err


def test_a_dry_run_and_another_file_leave_the_scene_alone(scene, operations, capsys, tmp_path):
    before = sha(scene)
    code, told = f4x(capsys, "edit", scene, "--ops", operations, "--dry-run")
    assert code == 0 and told["output"] is None and len(told["edits"]) == 3 and sha(scene) == before
    code, told = f4x(capsys, "edit", scene, "--ops", operations, "-o", tmp_path / "b.f4x")
    assert code == 0 and sha(scene) == before and len(read_stack(tmp_path / "b.f4x")) == 3
    np.testing.assert_array_equal(read_scene(tmp_path / "b.f4x").static.means, read_scene(scene).static.means)


def test_words_are_looked_up_once(scene, capsys, tmp_path):
    (tmp_path / "o.json").write_text(
        json.dumps({"op": "delete", "select": {"by": "text", "labels": ["square"], "negatives": ["wall"]}})
    )
    code, told = f4x(capsys, "edit", scene, "--ops", tmp_path / "o.json")
    assert code == 0 and told["edits"][0]["select"]["by"] == "ids" and told["gaussians"] == [81]


def test_of_two_that_change_places_both_are_counted(scene, capsys):
    for sentence, words, count in (
        ("swap the left half of the square and the right half of the square", "the other way: 45 and 36 Gaussians", 81),
        ("make the square glow red from frame 1 to 3", "(6.7 % of the scene's Gaussians): 81 Gaussians", 81),
    ):
        edit = ["edit", scene, "--say", sentence, "--dry-run"]
        assert f4x(capsys, *edit)[1]["gaussians"] == [count]
        assert main([*map(str, edit)]) == 0 and words in capsys.readouterr().out


def test_it_is_the_selection_that_a_query_left(scene, capsys, tmp_path):
    ids = labelled_scene().ids[3:8]
    chosen = Selection(ids, np.ones(5), np.zeros(5, bool))
    (tmp_path / "selection.json").write_text(json.dumps(chosen.to_json()))
    code, told = f4x(capsys, "edit", scene, "--say", "remove it", "--select", tmp_path / "selection.json")
    assert (
        code == 0
        and told["gaussians"] == [5]
        and told["edits"][0]["select"] == {**Ids.of(ids).to_json(), "words": "the selection"}
    )
    (tmp_path / "selection.json").write_text("{}")
    code = main(["edit", str(scene), "--say", "remove it", "--select", str(tmp_path / "selection.json")])
    assert code == 2 and "selection.json: This is no selection" in capsys.readouterr().err


def test_every_verb_sees_the_edits_unless_told_otherwise(scene, operations, capsys, tmp_path):
    f4x(capsys, "edit", scene, "--ops", operations)
    for name, more, count in (("with", (), 2), ("without", ("--without-edits",), 1)):
        code, told = f4x(capsys, "query", scene, "--text", "square", *more)
        assert code == 0 and told["chosen"] == 81 * count
        out = tmp_path / f"{name}.ply"
        assert f4x(capsys, "export", scene, "--time", 0, "-o", out, *more)[0] == 0
        assert out.exists()
        code, told = f4x(capsys, "info", scene, *more)
        assert code == 0 and ("edited" in told) == (name == "with")
    assert (tmp_path / "with.ply").stat().st_size > (tmp_path / "without.ply").stat().st_size
    assert f4x(capsys, "render", scene, "--path", "frozen:0", "-o", tmp_path / "r")[0] == 0
    assert f4x(capsys, "render", scene, "--path", "frozen:0", "-o", tmp_path / "s", "--without-edits")[0] == 0
    a, b = (next((tmp_path / name / "rgb").glob("*.png")).read_bytes() for name in ("r", "s"))
    assert a != b


def test_bake(scene, operations, capsys, tmp_path):
    operations.write_text(json.dumps(OPERATIONS[:2]))
    assert f4x(capsys, "bake", scene, "-o", tmp_path / "no.f4x")[0] == 2
    f4x(capsys, "edit", scene, "--ops", operations)
    before = sha(scene)
    assert main(["bake", str(scene), "-o", str(scene)]) == 2
    assert "give another file" in capsys.readouterr().err and sha(scene) == before
    code, told = f4x(capsys, "bake", scene, "-o", tmp_path / "b.f4x")
    assert code == 0 and (told["folded"], told["left"], told["dynamic"]) == (2, 0, 162)
    assert len(read_scene(tmp_path / "b.f4x").dynamic) == 162
    operations.write_text(json.dumps(OPERATIONS[2:]))
    f4x(capsys, "edit", scene, "--ops", operations)
    assert main(["bake", str(scene), "-o", str(tmp_path / "c.f4x")]) == 0
    assert (
        "2 edits folded in; these stay in the stack: delete, 1 name: edit 3 (delete) changes with time"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "no operation"),
        ('[{"op": "explode"}]', "operation 1: 'explode' is no op"),
        ('[{"op": "delete", "select": {"by": "moving"}}, 7]', "operation 2: 7 is no JSON object"),
        ('[{"op": "delete", "select": {"by": "named", "name": "rex"}}]', "named 'rex'"),
        ('[{"op": "delete", "select": {"by": "moving"}, "frames": [90, null]}]', "90"),
        ('[{"op": "delete", "select": {"by": "ids", "ids": [1, 9999999]}}]', "no Gaussian of the id 9999999"),
        ("[" * 100_000 + "]" * 100_000, "nested deeper than 100, a limit of Feature4X"),
        ('{"op": "delete", "select": ' + 90 * '{"by": "not", "of": ' + '{"by": "all"}' + 91 * "}", "write it flatter"),
    ],
)
def test_a_wrong_file_is_one_sentence_and_changes_nothing(scene, tmp_path, capsys, text, told):
    before = sha(scene)
    (tmp_path / "o.json").write_text(text)
    assert main(["edit", str(scene), "--ops", str(tmp_path / "o.json")]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("f4x edit: ") and told in error and "o.json" in error
    assert sha(scene) == before


def test_broken_edits_in_a_scene_can_be_left_out(tmp_path, capsys):
    path = tmp_path / "a.f4x"
    write_scene(random_scene(edits=({"op": "explode", "id": 1},)), path)
    assert main(["info", str(path)]) == 2
    assert "--without-edits opens it without" in capsys.readouterr().err
    assert main(["info", str(path), "--without-edits"]) == 0
    for verb in (["history", str(path)], ["undo", str(path)], ["bake", str(path), "-o", str(tmp_path / "b.f4x")]):
        assert main(verb) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_words_that_nobody_knows_are_asked_about_and_left_out_with_yes(scene, capsys):
    sentence = "make the square red and happy"
    assert main(["edit", str(scene), "--say", sentence, "--dry-run"]) == 2
    error = capsys.readouterr().err
    assert "I would do: make the square red. I do not know what 'and happy' adds." in error
    assert "Say 'make the square red', or add --yes." in error
    assert main(["edit", str(scene), "--say", sentence, "--dry-run", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["instead"] == "make the square red"
    code, told = f4x(capsys, "edit", scene, "--say", sentence, "--dry-run", "--yes")
    assert code == 0 and [edit["op"] for edit in told["edits"]] == ["recolour"]
    assert told["notes"] == ["Read as 'make the square red'."]
