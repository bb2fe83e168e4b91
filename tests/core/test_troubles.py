"""Codes of errors: every module that raises has a family, the sentence carries it, and the page explains it."""

import ast
import errno
import os
import re
from pathlib import Path

import pytest

from f4x_core.cli import main
from f4x_core.cli.doctor import anonymous
from f4x_core.errors import F4xError
from f4x_core.troubles import TOPS, TROUBLES, code_of, code_of_module, explain, with_code
from scripts.site_pages import TROUBLESHOOTING, sentences_of, troubleshooting

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [file for folder in TOPS for file in (ROOT / folder).rglob("*.py")]


def module_of(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


FOR_ITS_CALLER = "f4x_core.reading"
"""It has no family, so that what it raises gets that of the reader that called it."""


def test_every_module_that_raises_has_a_family():
    raising = [file for file in SOURCES if "raise F4xError(" in file.read_text(encoding="utf-8")]
    assert len(raising) > 100
    assert [module_of(file) for file in raising if code_of_module(module_of(file)) == "F4X-OTHER"] == [FOR_ITS_CALLER]


def test_every_family_names_modules_that_are_there():
    modules = {module_of(file) for file in SOURCES} | {"scripts", "tools"}
    assert [name for trouble in TROUBLES for name in trouble.modules if name not in modules] == []


def test_codes_and_modules_occur_once():
    codes = [trouble.code for trouble in TROUBLES]
    modules = [name for trouble in TROUBLES for name in trouble.modules]
    assert len(codes) == len(set(codes)) and len(modules) == len(set(modules))


@pytest.mark.parametrize(
    ("module", "code"),
    [
        ("f4x_core.clip.video", "F4X-CLIP"),
        ("f4x_core.scene.file", "F4X-SCENE"),
        ("f4x_core.scene.ply", "F4X-IMPORT"),
        ("f4x_core.scene.mesh.build", "F4X-EXPORT"),
        ("f4x_core.features.missing", "F4X-FEATURES"),
        ("bl_ext.user_default.feature4x.f4x_core.edit.stack", "F4X-EDIT"),
        ("bl_ext.user_default.feature4x.addon.scene.scene_object", "F4X-BLENDER"),
        ("somewhere.else", "F4X-OTHER"),
    ],
)
def test_the_longest_name_that_fits_decides(module, code):
    assert code_of_module(module) == code


def test_the_code_is_that_of_the_first_cause_and_stands_once():
    from f4x_core.edit.change import check_range

    try:
        try:
            check_range("strength", 2.0)
        except F4xError as error:
            raise F4xError(f"edit 3: {error}") from error
    except F4xError as error:
        outer = error
    assert code_of(outer) == "F4X-EDIT" and with_code(outer).endswith("[F4X-EDIT]")
    message = F4xError("the worker said so. [F4X-CLIP]")
    assert with_code(message) == "the worker said so. [F4X-CLIP]"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device", "a.f4x"),
            "a.f4x: No space left on device; nothing half-written was left behind; make room there or choose another place."
            " [F4X-DISK]",
        ),
        (
            FileNotFoundError(errno.ENOENT, "No such file", "a.json"),
            "a.json: there is no such file or folder; check the path. [F4X-OPTION]",
        ),
        (OSError("gone"), "out: gone; nothing half-written was left behind. [F4X-DISK]"),
        (MemoryError(), "The memory does not suffice; use fewer frames or smaller ones. [F4X-MEMORY]"),
        (MemoryError("3 GiB"), "The memory does not suffice (3 GiB); use fewer frames or smaller ones. [F4X-MEMORY]"),
        (F4xError("choose a .f4x file"), "choose a .f4x file. [F4X-OTHER]"),
        (F4xError("did you mean 'red'?"), "did you mean 'red'? [F4X-OTHER]"),
        (F4xError('Try: "make it red".'), 'Try: "make it red". [F4X-OTHER]'),
    ],
)
def test_every_expected_error_is_one_sentence_with_a_code(error, line):
    assert with_code(error, "out") == line


def test_a_full_disk_is_the_disk_whoever_says_so(tmp_path, monkeypatch):
    from f4x_core import files

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(F4xError) as caught, files.replace_file(tmp_path / "a") as file:
        file.write(b"a")
    assert code_of(caught.value) == "F4X-DISK"


def test_a_full_disk_under_an_exr_is_the_disk(tmp_path, monkeypatch):
    openexr = pytest.importorskip("OpenEXR")
    from f4x_core.scene.layers import write_exr

    class Full:
        def __init__(self, *_):
            raise RuntimeError('Failed to write pixel data to image file "x.exr". No space left on device.')

    monkeypatch.setattr(openexr, "File", Full)
    with pytest.raises(F4xError, match=r"x\.exr: cannot be written \(No space left on device\)") as caught:
        write_exr(tmp_path / "x.exr", {})
    assert code_of(caught.value) == "F4X-DISK" and not list(tmp_path.iterdir())


def test_a_script_belongs_to_its_folder():
    code = compile("raise F4xError('no')", str(ROOT / "scripts" / "door.py"), "exec")
    with pytest.raises(F4xError) as caught:
        exec(code, {"F4xError": F4xError, "__name__": "door"})
    assert code_of(caught.value) == "F4X-BLENDER"


def test_the_command_line_ends_its_sentence_with_the_code(tmp_path, capsys):
    (tmp_path / "scene.f4x").write_bytes(b"no scene")
    assert main(["info", str(tmp_path / "scene.f4x")]) == 2
    assert capsys.readouterr().err.rstrip().endswith("[F4X-SCENE]")
    assert main(["doctor", "f4x-scene"]) == 0 and "What helps:" in capsys.readouterr().out
    assert main(["doctor", "F4X-NOTHING"]) == 2 and "[F4X-OPTION]" not in capsys.readouterr().out


def test_every_code_is_explained_on_the_page():
    assert TROUBLESHOOTING.read_text(encoding="utf-8") == troubleshooting(), "run `python3 scripts/dev.py docs`"
    assert all(explain(trouble.code).count("\n") == 1 for trouble in TROUBLES)


def test_sentences_are_read_out_of_the_code():
    source = """def f():
    raise F4xError(f"{path}: {count} frames" " are too few; give more.") from error
"""
    assert sentences_of(ast.parse(source)) == ["…: … frames are too few; give more."]


def test_a_report_names_neither_paths_nor_people(monkeypatch):
    import getpass
    import platform

    monkeypatch.setattr(getpass, "getuser", lambda: "maria")
    monkeypatch.setattr(platform, "node", lambda: "marias-laptop")
    text = anonymous(
        "compiler: /opt/secret place/bin/c++ of maria on marias-laptop; 12 ms at 240x136\nC:\\Users\\max\\x.f4x"
    )
    assert not any(word in text for word in ("secret", "maria", "max", os.sep + "bin"))
    assert "12 ms at 240x136" in text and "Linux x86_64, 2 cores" in anonymous("Linux x86_64, 2 cores")


def bare_errors(source: str) -> list[int]:
    """Lines of the add-on that may show an error without its code: reports of its own, and the text of a caught F4xError."""
    tree, lines = ast.parse(source), []
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Call)
            and getattr(node.func, "attr", "") == "report"
            and "ERROR" in ast.unparse(node.args[0])
        ):
            lines.append(node.lineno)
        if isinstance(node, ast.ExceptHandler) and node.name and re.search("F4xError|EXPECTED", ast.unparse(node.type)):
            raised = {id(inner) for each in ast.walk(node) if isinstance(each, ast.Raise) for inner in ast.walk(each)}
            lines += [each.lineno for each in ast.walk(node) if id(each) not in raised and shows(each, node.name)]
    return lines


def shows(node: ast.AST, name: str) -> bool:
    """Whether a node turns the exception `name` into text as it is: str(error), f"{error}" or print(error)."""
    if isinstance(node, ast.FormattedValue):
        return ast.unparse(node.value) == name
    called = isinstance(node, ast.Call) and ast.unparse(node.func) in ("str", "print")
    return called and any(ast.unparse(argument) == name for argument in node.args)


@pytest.mark.parametrize(
    "file", [*sorted((ROOT / "addon").rglob("*.py")), ROOT / "scripts" / "door.py"], ids=lambda file: file.stem
)
def test_no_error_is_shown_in_blender_without_its_code(file):
    """`refuse` and `error_line` of addon/common/wording.py put it there; so does `with_code`, for scripts."""
    lines = bare_errors(file.read_text(encoding="utf-8"))
    assert len(lines) == (1 if file.stem == "wording" else 0), lines


@pytest.mark.parametrize("caught", ["(F4xError, OSError)", "EXPECTED"])
@pytest.mark.parametrize(
    "line",
    [
        'self.report({"ERROR"}, error_line(error))',
        "self.answer = str(error)",
        'print(f"Error: {error}")',
        "print(error)",
    ],
)
def test_an_error_without_its_code_would_be_seen(line, caught):
    assert bare_errors(f"try:\n    work()\nexcept {caught} as error:\n    {line}\n") == [4]
    assert (
        bare_errors("try:\n    work()\nexcept F4xError as error:\n    raise F4xError(f'{error} So.') from error\n")
        == []
    )
