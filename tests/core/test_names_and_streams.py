"""Names that people and files bring along, links, and standard streams that are full or closed: nothing crashes."""

import ast
import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene
from PIL import Image
from rich.table import Table

from f4x_core.app.paths import trajectory_of
from f4x_core.cli import serve
from f4x_core.cli.distilling import read_labels
from f4x_core.cli.main import EXIT_UNREAD, main
from f4x_core.cli.terminal import TerminalProgress
from f4x_core.clip import read_clip
from f4x_core.edit.stack import read_stack
from f4x_core.errors import F4xError
from f4x_core.features.maps import replace_folder
from f4x_core.files import link_target, replace_file, user_path
from f4x_core.page import document
from f4x_core.printing import OUTPUT, escaped, one_line
from f4x_core.priors.files import _read_array as read_prior_file
from f4x_core.scene import read_scene, write_edits, write_scene
from f4x_core.scene.formats import export
from f4x_core.scene.layers import write_exr

ROOT = Path(__file__).parents[2]
CODES = "\x1b]0;title\x07\x1b[31m\u202e\r\x9b2J\n"
"""Sets a terminal's title, colours it, turns a line round and empties the screen."""
OPACITY = {"op": "opacity", "select": {"by": "all"}, "factor": 0.5}
needs_links = pytest.mark.skipif(os.name == "nt", reason="links need rights there")
needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")


def printed(capsys):
    """All that was printed; it holds no code that steers a terminal."""
    text = "".join(capsys.readouterr())
    assert text == escaped(text)
    return text


@pytest.fixture
def scene(tmp_path):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    (tmp_path / "ops.json").write_text(f"[{OPACITY}]".replace("'", '"'))
    return tmp_path / "scene.f4x"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain: ü 場面 👩‍🚀\tand\nlines", None),
        ("\x1b[31m\x07\x08\r\x7f\x9b", r"\x1b[31m\x07\x08\x0d\x7f\x9b"),
        ("\u202egnp.\u2066\u200f\ufeff\u2028", r"\u202egnp.\u2066\u200f\ufeff\u2028"),
        (os.fsdecode(b"\xff") if os.name != "nt" else "\udcff", r"\xff"),
        ("\ud800\U000e0041", r"\ud800\U000e0041"),
    ],
)
def test_what_steers_a_terminal_is_written_out(text, shown):
    assert escaped(text) == (text if shown is None else shown)
    assert one_line(text) == escaped(text).replace("\n", "\\n")
    escaped(text).encode()


def test_codes_inside_a_scene_are_not_printed_raw(scene, capsys):
    found = labelled_scene()
    words = found.features.vocabularies["words"]
    field = replace(found.features, vocabularies={"words": replace(words, labels=(f"w{CODES}", *words.labels[1:]))})
    made = {"source": f"s{CODES}", "frames": CODES, "feature4x": CODES}
    edits = ({"op": "recolour", "select": {"by": "all"}, "rgb": [1, 0, 0], "id": 1, "said": f"t{CODES}"},)
    write_scene(replace(found, name=f"n{CODES}", provenance=made, features=field, edits=edits), scene)
    for verb in ("info", "history", "undo", "redo"):
        assert main([verb, str(scene)]) == 0
    assert main(["info", f"missing{CODES}"]) == 2
    lines = printed(capsys).splitlines()
    assert len([line for line in lines if line.startswith(("name:", "source:", "made by:", "1 "))]) == 4


@pytest.mark.parametrize(
    "name",
    [
        "a:b",
        "10:30",
        "~nobody-of-that-name",
        "~",
        "-x",
        "--json",
        "http:x",
        "a\nb",
        f"a{CODES.strip()}",
        "end ",
        " ",
        "%s{0}$HOME`id`'\"",
        "[a]*?",
        "ü" * 120,
        "😀" * 62,
        "x" * 250,
        pytest.param(
            os.fsdecode(b"\xff\xfe"), marks=pytest.mark.skipif(sys.platform != "linux", reason="no such names")
        ),
    ],
)
@pytest.mark.skipif(os.name == "nt", reason="other names are allowed there")
def test_scenes_of_any_name_are_edited(scene, monkeypatch, capsys, name):
    monkeypatch.chdir(scene.parent)
    file = f"./{name}.f4x"
    os.rename(scene, file)
    assert main(["edit", file, "--ops", "ops.json"]) == main(["info", file]) == 0
    assert len(read_stack(file)) == 1
    assert main(["undo", file]) == 0 and main(["bake", file, "-o", "./baked.f4x"]) == 2  # nothing to bake any more
    if name == "-x":
        assert main(["info", "-x.f4x"]) == 2 and "is written ./-x.f4x" in printed(capsys)
    assert sorted(os.listdir()) == sorted(["ops.json", os.path.basename(file)])
    printed(capsys)


def test_a_tilde_is_a_home_only_where_there_is_one(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME" if os.name != "nt" else "USERPROFILE", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert user_path("~/a.mp4") == tmp_path / "a.mp4" and user_path("~nobody-of-that-name") == Path(
        "~nobody-of-that-name"
    )
    Path("~").touch()
    assert user_path("~") == Path("~")
    with pytest.raises(F4xError, match="does not exist"):
        read_clip("~nobody-of-that-name.mp4")


def test_lists_and_paths_that_only_look_like_something_else(scene, monkeypatch):
    monkeypatch.chdir(scene.parent)
    words = [f"word{number}" for number in range(100)]
    assert read_labels(",".join(words)) == words  # longer than a name may be
    found = labelled_scene()
    found.cameras.write("slow:x.json")
    assert len(trajectory_of(found, "slow:x.json", 5.0)) == len(found.cameras)


@pytest.mark.skipif(sys.platform != "linux", reason="no such names")
def test_libraries_meet_names_that_are_no_text(tmp_path):
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    Image.new("L", (4, 3), 200).save(folder / "00000.png")
    assert read_prior_file("mask", folder / "00000.png").shape == (3, 4)
    with pytest.raises(F4xError, match="OpenEXR cannot write"):
        write_exr(folder / "a.exr", {"Depth": (np.zeros((2, 2, 1), np.float32), "Z")})
    assert [file.name for file in folder.iterdir()] == ["00000.png"]


def test_a_name_that_is_no_text_is_kept_in_a_scene_and_shown_on_a_page(tmp_path):
    name = "\udcff.mp4"  # a byte that is no UTF-8, as Python reads it
    write_scene(replace(labelled_scene(), provenance={"source": name}), tmp_path / "a.f4x")
    assert read_scene(tmp_path / "a.f4x").provenance["source"] == name
    assert b"<h1>\\udcff.mp4</h1>" in document(name, [])


# Links


@pytest.fixture
def linked(tmp_path):
    """A link in one folder to a relative link in another, which leads to a file in a third, and that file's name."""
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
    (tmp_path / "a" / "one.ply").symlink_to(tmp_path / "folder" / "two")
    (tmp_path / "folder").symlink_to("b")
    (tmp_path / "b" / "two").symlink_to("../c/three.ply")
    return tmp_path / "a" / "one.ply", tmp_path / "c" / "three.ply"


@needs_links
@pytest.mark.parametrize("there", [True, False], ids=["file", "nothing there yet"])
@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_scene(labelled_scene(), path),
        lambda path: labelled_scene().cameras.write(path),
        lambda path: export(labelled_scene(), path, [0.0], "ply"),
    ],
    ids=["scene", "cameras", "export"],
)
def test_writers_replace_what_a_link_leads_to(linked, write, there):
    link, target = linked
    if there:
        target.write_bytes(b"old")
    write(link)
    assert link.is_symlink() and target.stat().st_size > 100 and not target.is_symlink()
    assert len(list(target.parent.iterdir())) == len(list(link.parent.iterdir())) == 1


@needs_links
def test_verbs_edit_what_a_link_leads_to(scene, capsys):
    link, other = scene.parent / "link.f4x", scene.parent / "other.f4x"
    link.symlink_to("scene.f4x")
    other.symlink_to("link.f4x")
    ops = str(scene.parent / "ops.json")
    assert main(["edit", str(other), "--ops", ops]) == main(["edit", str(scene), "--ops", ops, "-o", str(link)]) == 0
    write_edits(link, [*read_scene(scene).edits, {**OPACITY, "id": 3}])
    assert main(["undo", str(other)]) == 0 and main(["bake", str(scene), "-o", str(other)]) == 2
    assert len(read_stack(scene)) == 2 and len(read_stack(scene).undone) == 1
    assert link.is_symlink() and other.is_symlink() and not scene.is_symlink()


@needs_links
def test_a_link_to_a_folder_stays(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "link").symlink_to("maps")
    with replace_folder(tmp_path / "link", "spec.json") as part:
        (part / "spec.json").touch()
    assert (tmp_path / "link").is_symlink() and [file.name for file in (tmp_path / "maps").iterdir()] == ["spec.json"]
    assert len(list(tmp_path.iterdir())) == 2


@needs_links
def test_a_loop_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(F4xError, match="leads back to itself"), replace_file(tmp_path / "a"):
        pytest.fail("nothing may be written")
    assert link_target(tmp_path / "c") == tmp_path / "c" and len(list(tmp_path.iterdir())) == 2


# Streams


def full():
    return open("/dev/full", "w")  # main replaces its descriptor


def unread():
    """A pipe whose reader has gone."""
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w")


@needs_full
@pytest.mark.parametrize("option", [(), ("--json",), ("--progress-json",)], ids=["text", "json", "lines"])
@pytest.mark.parametrize("verb", ["info", "edit", "wrong", "--help"])
def test_standard_output_that_is_full_or_closed_is_no_crash(scene, monkeypatch, capsys, verb, option):
    arguments = [verb, str(scene), *option] + ["--ops", str(scene.parent / "ops.json")] * (verb == "edit")
    for count, (stream, code) in enumerate([(full(), 2), (unread(), EXIT_UNREAD), (None, 0)], 1):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", stream)
            code = 130 if code == EXIT_UNREAD and option == ("--progress-json",) else code  # stopped with its parent
            try:
                assert main(arguments) == (2 if verb == "wrong" and code != 130 else code)
            except SystemExit as end:  # how argparse ends after --help
                assert verb == "--help" and end.code == 0 and stream is None
        if stream is not None:
            stream.close()  # which would fail if something were left in it
        if verb == "edit" and option != ("--progress-json",):
            assert len(read_stack(scene)) == count
    assert ("standard output: No space left on device" in printed(capsys)) == (
        verb != "wrong" or "--progress-json" in option
    )


@needs_full
def test_the_end_of_a_process_with_a_full_standard_output_is_one_sentence():
    with full() as stream:
        ended = subprocess.run(
            [sys.executable, "-m", "f4x_core", "--version"], stdout=stream, stderr=subprocess.PIPE, cwd=ROOT
        )
    assert ended.returncode == 2 and ended.stderr.count(b"\n") == 1 and b"[F4X-DISK]" in ended.stderr


@needs_full
@pytest.mark.parametrize("stream", [full, unread])
def test_work_goes_on_where_standard_error_takes_nothing(scene, monkeypatch, stream):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", stream())
        with TerminalProgress() as progress:
            for done in range(3):
                progress("stage", done, 2)
        assert main(["info", str(scene)]) == 0 and main(["info", "missing"]) == 2
        sys.stderr.close()


def test_progress_of_odd_names_steers_no_terminal(capsys):
    with TerminalProgress() as progress:
        progress(f"stage {CODES}", 0, 2, f"message {CODES}")
        progress.console.print(f"line {CODES}")
        table = Table(f"head {CODES}", show_footer=True)
        table.add_row(f"cell {CODES}")
        progress.console.print(table)
    assert printed(capsys).count(r"\x1b[31m") == 5


def test_an_agent_that_has_gone_ends_its_server_quietly(monkeypatch):
    gone = BrokenPipeError(errno.EPIPE, "Broken pipe")
    with unread() as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        reason = serve._reason(ExceptionGroup("tasks", [ExceptionGroup("more", [gone])]))
        print("what is left", file=stream)  # goes nowhere
    assert isinstance(reason, BrokenPipeError) and reason.filename == OUTPUT
    assert isinstance(serve._reason(ExceptionGroup("tasks", [ZeroDivisionError()])), ZeroDivisionError)


def test_the_command_line_prints_by_one_door():
    """No module of it calls `print` or makes a console of its own."""
    for file in sorted((ROOT / "f4x_core" / "cli").glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            name = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
            assert name not in ("print", "Console"), f"{file.name}:{node.lineno}"


@pytest.mark.skipif(os.name == "nt", reason="descriptors of POSIX")
@pytest.mark.parametrize("closed", ["2>&-", "0<&- 1>&- 2>&-"])
def test_streams_that_are_closed_at_the_start_keep_no_verb_from_its_work(scene, closed):
    command = f'exec "$0" -m f4x_core history "$1" --json {closed}'
    done = subprocess.run(["sh", "-c", command, sys.executable, str(scene)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done
    assert "1>&-" in closed or json.loads(done.stdout)["edits"] == []
