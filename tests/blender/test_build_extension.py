"""The zip of the extension: the libraries of the present sources and no others, whatever else was built in the tree."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from f4x_core.native.library import library_path

ROOT = Path(__file__).resolve().parents[2]
BUILT = "f4x_core/native/_build"


@pytest.fixture
def used_tree(tmp_path):
    """A copy of the repository that has been worked in for a while."""
    tree = tmp_path / "tree"
    for part in ("addon", "docs", "f4x_core", "ground_truth", "scripts"):
        shutil.copytree(ROOT / part, tree / part, ignore=shutil.ignore_patterns("__pycache__", "_build"))
    for name in ("__init__.py", "blender_manifest.toml", "pyproject.toml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, tree)
    (tree / BUILT).mkdir()
    for name in (
        *(library_path(target).name for target in ("linux-x86_64", "windows-x86_64")),
        "f4x-0123456789abcdef-linux-x86_64.so",  # of older sources
        "tmp9o5spg46",  # of a build that was interrupted
    ):
        (tree / BUILT / name).write_bytes(name.encode())
    return tree


def test_only_libraries_of_the_present_sources_are_packed(used_tree, tmp_path):
    command = [sys.executable, str(used_tree / "scripts/build_extension.py"), "-o", str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": str(used_tree)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["kernels"] == ["linux-x86_64", "windows-x86_64"]
    with zipfile.ZipFile(result["output"]) as archive:
        names = archive.namelist()
    packed = {Path(name).name for name in names if BUILT in name and not name.endswith("/")}
    assert packed == {library_path(target).name for target in ("linux-x86_64", "windows-x86_64")}
    assert "addon/registration.py" in names and not any(
        name.startswith(("tests/", "docs/images", "benchmarks/", "ground_truth/", "tools/")) for name in names
    )
    assert "docs/blender.md" in names  # the button Documentation opens it
