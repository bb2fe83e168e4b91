"""`f4x bench` and `f4x report`: they run the laboratory of their own checkout; an installation says where to get it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from f4x_core.cli import laboratory
from f4x_core.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
REPORT = ("report", "--quick", "--only", "weather", "-o")
"""Ends at once, with a sentence that only the laboratory's catalogue can say."""


@pytest.mark.parametrize("words", [("bench", "raster"), (*REPORT, "report")], ids=("bench", "report"))
def test_an_installation_says_where_the_laboratory_is(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(laboratory, "CHECKOUT", tmp_path)
    assert main([*words, "--json"]) != 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["error"] in printed.err and len(printed.err.splitlines()) == 1
    assert "checkout" in printed.err and f"f4x {words[0]}" in printed.err


def run_there(place: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """`f4x report` in `folder`, with the `f4x_core` of `place` and nothing of this checkout on the path."""
    start = f"import sys; sys.path.insert(0, {str(place)!r})"
    program = f"{start}\nfrom f4x_core.cli.main import main\nsys.exit(main())"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [sys.executable, "-c", program, *REPORT, "page"]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_a_copy_without_the_laboratory_does_not_take_another_package_of_its_name(tmp_path):
    shutil.copytree(ROOT / "f4x_core", tmp_path / "site" / "f4x_core", ignore=shutil.ignore_patterns("__pycache__"))
    other = tmp_path / "work" / "benchmarks"
    other.mkdir(parents=True)
    for name in ("__init__", "bench", "report"):
        (other / f"{name}.py").write_text("raise SystemExit('another package')")
    done = run_there(tmp_path / "site", tmp_path / "work")
    assert done.returncode == 2 and "checkout" in done.stderr and "another package" not in done.stderr


def test_the_laboratory_is_found_from_any_folder(tmp_path):
    """As by an editable installation, which puts `f4x_core` alone on the path."""
    (tmp_path / "f4x_core").symlink_to(ROOT / "f4x_core")
    done = run_there(tmp_path, tmp_path)
    assert done.returncode == 2 and "no study or part of the report" in done.stderr
