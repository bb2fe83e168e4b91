"""What a release rests on: one version everywhere, notes from the change log, zips that are the same twice, documents that show."""

import re
import shlex
import zipfile
from pathlib import Path

import pytest

from f4x_core.cli.parser import build_parser
from f4x_core.versions import VERSION
from scripts import dev
from scripts.build_extension import blender_platform, reproducible
from scripts.release import ReleaseError, copy_examples, repeated_versions, section_of, write_sums

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"\]\(([^)\s]+)")
SHELL = re.compile(r"```bash\n(.*?)```", re.DOTALL)


def test_every_file_that_repeats_the_version_has_it():
    assert set(repeated_versions(ROOT).values()) == {VERSION}
    assert section_of((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), VERSION)


def test_notes_are_the_section_of_the_version():
    log = "# Changes\n\n## 0.2.0\n\n* new\n\n## 0.1.0 (2026)\n\n* first\n"
    assert section_of(log, "0.2.0") == "* new\n" and section_of(log, "0.1.0") == "* first\n"
    with pytest.raises(ReleaseError, match=r"says nothing under .## 0\.1"):
        section_of("## 0.1\n\n## 0.0\n\nold", "0.1")


def test_the_same_contents_make_the_same_zip(tmp_path):
    for name, order, date in (("a", "xy", 1990), ("b", "yx", 2020)):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for entry in order:
                archive.writestr(zipfile.ZipInfo(entry, (date, 1, 1, 0, 0, 0)), entry * 50)
        reproducible(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert zipfile.ZipFile(tmp_path / "a").read("y") == b"y" * 50


def test_sums_name_every_file_but_themselves(tmp_path):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "file").write_bytes(b"")
    for _ in range(2):
        write_sums(tmp_path)
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert (tmp_path / "SHA256SUMS").read_text() == f"{empty}  part/file\n"


def test_examples_are_copied_as_they_were_made(tmp_path):
    made = tmp_path / "made"
    made.mkdir()
    (made / "a.f4x").write_bytes(b"scene")
    write_sums(made)
    (made / "notes.txt").write_text("of somebody else")
    copy_examples(made, tmp_path / "copy")
    assert [file.name for file in (tmp_path / "copy").iterdir()] == ["a.f4x"]
    (made / "a.f4x").write_bytes(b"another")
    with pytest.raises(ReleaseError, match=r"a.f4x is not what was made there"):
        copy_examples(made, tmp_path / "second")


def test_blender_calls_platforms_otherwise():
    assert [blender_platform(name) for name in ("linux-x86_64", "macos-arm64")] == ["linux-x64", "macos-arm64"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_files_lead_somewhere(page):
    targets = [target.partition("#")[0] for target in LINK.findall(page.read_text(encoding="utf-8"))]
    local = [
        target
        for target in targets
        if target and ":" not in target and not target.startswith(("NAME", "results", "api/"))
    ]
    assert [target for target in local if not (page.parent / target).exists()] == []


def test_quoted_diagnoses_were_said_of_the_films_shown():
    text = (ROOT / "docs" / "which_clips.md").read_text(encoding="utf-8")
    poor = text[text.index("## Poor") :]
    said = (ROOT / "benchmarks" / "results" / "hard-cases.json").read_text(encoding="utf-8")
    quotes = re.findall(r"^> (.+)$", poor, re.MULTILINE)
    assert len(quotes) >= 6 and [quote for quote in quotes if quote not in said] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_a_page_are_commands_that_there_are(page):
    """Verbs and options of `f4x`, verbs of `dev.py`, scripts; nothing is run."""
    lines = "".join(SHELL.findall(page.read_text(encoding="utf-8"))).splitlines()
    for words in (shlex.split(re.sub(r"^(\w+=\S* )+", "", line), comments=True) for line in lines):
        if words[:1] == ["f4x"]:
            build_parser().parse_args(words[1:])
        elif words[1:2] == ["scripts/dev.py"]:
            assert words[2] in dev.VERBS
        for word in words:
            assert not word.startswith(("scripts/", "tools/")) or (ROOT / word).is_file(), word
