"""Paths, locks and atomic replacement as the system at hand has them: Windows and the others differ, and both are tested."""

import os
import subprocess
import sys
import time

import pytest

from f4x_core.errors import F4xError
from f4x_core.files import LOCK, lock_file, replace_file, sole_writer

WINDOWS = os.name == "nt"
HOLD = """
import sys, time
from pathlib import Path
from f4x_core.files import lock_file
with lock_file(Path(sys.argv[1]), "busy"):
    print("held", flush=True)
    time.sleep(120)
"""


def fill(path, content):
    with replace_file(path) as file:
        file.write(content)


@pytest.mark.parametrize("name", ["scene.f4x", "ein Name mit Lücken.f4x", "場面.f4x", "x" * 120 + ".f4x"])
def test_a_file_is_replaced_whole_under_any_name(tmp_path, name):
    path = tmp_path / name
    for content in (b"old", b"new and longer"):
        fill(path, content)
        assert path.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir()] == [name]


def test_a_file_that_is_being_read_is_never_half_new(tmp_path):
    """Windows refuses to replace it, in one sentence, and the old one stays; elsewhere the reader keeps the old content."""
    path = tmp_path / "scene.f4x"
    fill(path, b"old")
    with path.open("rb") as reader:
        if WINDOWS:
            with pytest.raises(F4xError, match="cannot be written"):
                fill(path, b"new")
        else:
            fill(path, b"new")
        assert reader.read() == b"old"
    assert path.read_bytes() == (b"old" if WINDOWS else b"new")
    assert [each.name for each in tmp_path.iterdir()] == ["scene.f4x"]


def test_a_replacement_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "scene.f4x"
    fill(path, b"old")
    with pytest.raises(ZeroDivisionError), replace_file(path) as file:
        file.write(b"half")
        raise ZeroDivisionError
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes among its files")
def test_what_is_no_ordinary_file_is_never_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("pipe", "no ordinary file"), (".", "a folder")):
        with pytest.raises(F4xError, match=words), replace_file(tmp_path / name):
            pytest.fail("nothing may be written")
    assert (tmp_path / "pipe").is_fifo() and len(list(tmp_path.iterdir())) == 1


def test_a_lock_keeps_another_process_out_and_ends_with_it(tmp_path):
    path = tmp_path / "lock"
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline().strip() == b"held"
        with pytest.raises(F4xError, match="busy"), lock_file(path, "busy"):
            pass
        if WINDOWS:
            with pytest.raises(PermissionError):  # an open file cannot be removed
                path.unlink()
        process.kill()
        process.wait()
        with lock_file(path, "still busy", patience=10.0):
            assert path.exists()
    finally:
        process.kill()
        process.communicate()
    assert not path.exists()


def test_a_lock_is_waited_for(tmp_path):
    start = time.monotonic()
    with lock_file(tmp_path / "lock", "busy"), pytest.raises(F4xError), lock_file(tmp_path / "lock", "busy", 0.3):
        pass
    assert time.monotonic() - start >= 0.3


def test_a_folder_of_one_writer_is_gone_when_nothing_was_written(tmp_path):
    with sole_writer(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / LOCK).exists()
        with pytest.raises(F4xError, match="another fit"), sole_writer(tmp_path / "a" / "b"):
            pass
    assert not (tmp_path / "a").exists()
