"""Objects kept between builds: taken when all they were made of is the same, and never when they are not what they were."""

import shutil

import pytest

from f4x_core.errors import F4xError
from f4x_core.native import build
from f4x_core.native.library import ROOM

PLATFORM = "linux-x86_64"
SMALLEST = ROOM / "peak.cpp"


@pytest.fixture
def runs(monkeypatch):
    """Commands of the compiler, which is the one on the path: ziglang may not be there."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no g++ or clang++ here")
    commands, run = [], build.run_compiler
    monkeypatch.setattr(build, "find_compiler", lambda target: [compiler])
    monkeypatch.setattr(build, "zig_version", lambda: "1")
    monkeypatch.setattr(build, "run_compiler", lambda command, *rest: (commands.append(command), run(command, *rest)))
    return commands


def test_an_object_is_made_once(tmp_path, runs):
    first = build.object_of(SMALLEST, PLATFORM, tmp_path)
    assert build.object_of(SMALLEST, PLATFORM, tmp_path) == first
    assert len(runs) == 1 and "-O3" in runs[0]
    assert list(tmp_path.iterdir()) == [first]


def test_a_damaged_object_is_made_anew(tmp_path, runs):
    first = build.object_of(SMALLEST, PLATFORM, tmp_path)
    whole = first.read_bytes()
    first.write_bytes(whole[:-1])
    assert build.object_of(SMALLEST, PLATFORM, tmp_path).read_bytes() == whole
    assert len(runs) == 2


def test_another_compiler_source_or_platform_makes_another_object(tmp_path, runs, monkeypatch):
    made = [build.object_of(SMALLEST, PLATFORM, tmp_path), build.object_of(SMALLEST, "windows-x86_64", tmp_path)]
    made.append(build.object_of(ROOM / "bundle.cpp", PLATFORM, tmp_path))
    monkeypatch.setattr(build, "zig_version", lambda: "2")
    made.append(build.object_of(SMALLEST, PLATFORM, tmp_path))
    assert len(runs) == len(set(made)) == 4


def test_a_source_that_does_not_compile_leaves_nothing(tmp_path, runs, monkeypatch):
    monkeypatch.setattr(build, "FLAGS", ["-include", "no_such_header.hpp"])
    with pytest.raises(F4xError, match=r"does not compile with .*: .*no_such_header"):
        build.object_of(SMALLEST, PLATFORM, tmp_path)
    assert not list(tmp_path.iterdir())
