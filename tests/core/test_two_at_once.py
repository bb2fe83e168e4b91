"""Two programs that change one scene, or fit into one folder, at once: nothing is lost, or the second is refused."""

import contextlib
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.cli import distilling
from f4x_core.cli.main import main
from f4x_core.cli.parser import build_parser
from f4x_core.edit.operations import Opacity
from f4x_core.edit.selects import All
from f4x_core.edit.stack import read_stack, write_stack
from f4x_core.errors import F4xError
from f4x_core.files import lock_file, sole_writer
from f4x_core.fit.vocabulary import with_vocabulary
from f4x_core.progress import silent
from f4x_core.scene import read_scene, write_scene

HOLD = """
import sys, time
from pathlib import Path
from f4x_core.files import lock_file
with lock_file(Path(sys.argv[1]), "busy"):
    print("held", flush=True)
    time.sleep(60)
"""


class Encoder:
    """One vector for every word."""

    def encode(self, labels):
        return np.eye(8, dtype=np.float32)[[5] * len(labels)]


def distill(scene, *options):
    return distilling.run_distill(build_parser().parse_args(["distill", str(scene), *options]), silent)


@pytest.fixture
def scene(tmp_path):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    return tmp_path / "scene.f4x"


def test_two_look_ups_at_once_keep_all_words(scene, monkeypatch):
    both = threading.Barrier(2)

    def add(scene, labels, **options):
        # so that both have read the file before either writes, unless one waits for the other
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(1)
        return with_vocabulary(scene, labels, lambda name: Encoder(), **options)

    monkeypatch.setattr(distilling, "with_vocabulary", add)
    threads = [threading.Thread(target=distill, args=(scene, "--vocabulary", word)) for word in ("boat", "ship")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {"boat", "ship", "square"} <= set(read_scene(scene).features.vocabularies["words"].labels)
    assert list(scene.parent.iterdir()) == [scene]


def test_an_edit_saved_while_words_are_added_stays(scene, monkeypatch):
    def add(found, labels, **options):
        write_stack(scene, read_stack(scene).append(Opacity(All(), 0.5)))  # somebody else, meanwhile
        return with_vocabulary(found, labels, lambda name: Encoder(), **options)

    monkeypatch.setattr(distilling, "with_vocabulary", add)
    distill(scene, "--vocabulary", "boat")
    assert len(read_stack(scene)) == 1 and "boat" in read_scene(scene).features.vocabularies["words"].labels


def test_a_scene_that_stays_busy_is_refused(scene, monkeypatch):
    monkeypatch.setattr(distilling, "PATIENCE", 0.2)
    with distilling.only_distiller(scene), pytest.raises(F4xError, match="another `f4x distill`"):
        distill(scene, "--vocabulary", "boat")


@pytest.mark.parametrize("verb", ["fit", "priors"])
def test_a_second_fit_into_one_folder_is_refused(tmp_path, capsys, verb):
    out = tmp_path / "out"
    with sole_writer(out):
        assert main([verb, str(tmp_path / "clip.mp4"), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"{out}: another fit" in said and said.strip().count("\n") == 0
    assert not out.exists()


def test_a_lock_ends_with_its_process(tmp_path):
    lock = tmp_path / "lock"
    with subprocess.Popen([sys.executable, "-c", HOLD, str(lock)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(F4xError, match="busy"), lock_file(lock, "busy"):
            pass
        holder.kill()
        holder.wait()
        with lock_file(lock, "busy", patience=5):
            pass
    assert not lock.exists()


def test_a_folder_that_nothing_was_written_into_goes_again(tmp_path):
    with pytest.raises(ZeroDivisionError), sole_writer(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    with sole_writer(tmp_path / "a"):
        Path(tmp_path / "a" / "scene.f4x").touch()
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["scene.f4x"]
