"""Two programs that change one scene, or fit into one folder, at once: nothing is lost, or the second is refused."""

import contextlib
import itertools
import json
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.agent.folder import SceneFolder
from f4x_core.agent.session import Session
from f4x_core.app import distilling
from f4x_core.cli.distilling import run_distill
from f4x_core.cli.main import main
from f4x_core.cli.parser import build_parser
from f4x_core.edit.apply import edited, stack_of
from f4x_core.edit.merging import merge_edits
from f4x_core.edit.operations import Duplicate, Opacity, TakeBack
from f4x_core.edit.selects import All, Ids
from f4x_core.edit.stack import EditStack, merge, read_stack, undo, with_stack, write_stack
from f4x_core.errors import F4xError
from f4x_core.files import sole_writer
from f4x_core.fit.vocabulary import with_vocabulary
from f4x_core.progress import silent
from f4x_core.scene import locking, read_scene, updating, write_scene

UPDATE = """
import sys, time
from f4x_core.files import replace_file
from f4x_core.scene import updating
with updating(sys.argv[1]), replace_file(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""
OPS = json.dumps([{"op": "opacity", "select": {"by": "all"}, "factor": 0.5}])


class Encoder:
    """One vector for every word."""

    def encode(self, labels):
        return np.eye(8, dtype=np.float32)[[5] * len(labels)]


def distill(scene, *options):
    return run_distill(build_parser().parse_args(["distill", str(scene), *options]), silent)


@pytest.fixture
def scene(tmp_path):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    return tmp_path / "scene.f4x"


def by_agent(path):
    """Propose an edit and write it; an agent whose scene was edited in between proposes again."""
    session = Session(SceneFolder(path))
    while True:
        proposal = session.propose_edit(operations=[{"op": "opacity", "select": {"by": "moving"}, "factor": 0.25}])
        try:
            return session.apply_edit(proposal.data["proposal"])
        except F4xError as error:
            assert "was edited after" in str(error)


def verb(*arguments):
    """A writer of the scene: `f4x` with these arguments, {} standing for the scene and {folder} for its folder."""
    return lambda path: main([argument.format(path, folder=path.parent) for argument in arguments])


WRITERS = {
    "edit": verb("edit", "{}", "--ops", "{folder}/ops.json"),
    "undo": verb("undo", "{}"),
    "name": verb("name", "{}", "gizmo", "--text", "square"),
    "distill": verb("distill", "{}", "--vocabulary", "boat"),
    "say": verb("edit", "{}", "--say", "make the square red", "-o", "{}"),
    "redo": verb("redo", "{}"),
    "agent": by_agent,
    "bake": verb("bake", "{}", "-o", "{folder}/baked.f4x"),
}
"""Everything that changes a scene without Blender, and what reads one into another."""
EVERY_DAY = ("edit", "undo", "name", "distill", "agent")


def two_edits_and_an_undone_one(folder):
    folder.mkdir()
    write_scene(labelled_scene(), folder / "scene.f4x")
    write_stack(
        folder / "scene.f4x", stack_of(labelled_scene(), *[Opacity(All(), factor) for factor in (0.9, 0.8, 0.7)])
    )
    undo(folder / "scene.f4x")
    (folder / "link.f4x").symlink_to("scene.f4x")
    (folder / "ops.json").write_text(OPS)


def held_by(folder):
    """The content of the scene of a folder, in which nothing else may have been left."""
    assert (folder / "link.f4x").is_symlink() and not [file for file in folder.iterdir() if file.name.startswith(".")]
    scene, stack = edited(read_scene(folder / "scene.f4x")), read_stack(folder / "scene.f4x")
    words = sorted(scene.features.vocabularies["words"].labels)
    baked = folder / "baked.f4x"
    folded = len(read_scene(baked).provenance["baked"]) if baked.exists() else 0
    return json.dumps([stack.to_json(), [edit.to_json() for edit in stack.undone], words, folded])


def serial(base, folder, first, second):
    """The content of the scene after one writer and then another."""
    shutil.copytree(base, folder, symlinks=True)
    WRITERS[first](folder / "scene.f4x")
    assert held_by(folder) != held_by(base), first
    WRITERS[second](folder / "scene.f4x")
    return held_by(folder)


def all_pairs(tmp_path, names, rounds):
    """Run every pair of writers at once, one of them through a link: the scene is as after one and then the other."""
    base = tmp_path / "base"
    two_edits_and_an_undone_one(base)
    for pair in itertools.combinations_with_replacement(names, 2):
        orders = {pair, pair[::-1]}
        expected = {serial(base, tmp_path / f"{order}", *order) for order in orders}
        for number in range(rounds):
            folder = tmp_path / f"{pair} {number}"
            shutil.copytree(base, folder, symlinks=True)
            files = (folder / "scene.f4x", folder / "link.f4x")
            threads = [
                threading.Thread(target=WRITERS[name], args=(file,)) for name, file in zip(pair, files, strict=True)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            assert held_by(folder) in expected, (pair, number)
            shutil.rmtree(folder)


@pytest.fixture
def words(monkeypatch):
    monkeypatch.setattr(
        distilling,
        "with_vocabulary",
        lambda scene, labels, **options: with_vocabulary(scene, labels, lambda name: Encoder(), **options),
    )


def test_pairs_of_writers_at_once_lose_nothing(tmp_path, words):
    all_pairs(tmp_path, EVERY_DAY, 1)


@pytest.mark.slow
def test_all_pairs_of_writers_at_once_lose_nothing_in_fifty_rounds(tmp_path, words):
    all_pairs(tmp_path, list(WRITERS), 50)


def test_two_processes_edit_one_scene(scene):
    (scene.parent / "ops.json").write_text(OPS)
    command = [sys.executable, "-m", "f4x_core", "edit", str(scene), "--ops", str(scene.parent / "ops.json")]
    for process in [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(2)]:
        assert process.wait() == 0
    assert [edit.id for edit in read_stack(scene).edits] == [1, 2]


def test_the_lock_of_a_killed_writer_is_taken_over(scene):
    with subprocess.Popen([sys.executable, "-c", UPDATE, str(scene)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(F4xError, match=r"scene\.f4x: another program is changing this scene"), updating(scene, 0.1):
            pass
        holder.kill()
    write_stack(scene, EditStack().append(Opacity(All(), 0.5)))
    assert len(read_stack(scene)) == 1 and list(scene.parent.iterdir()) == [scene]


@pytest.mark.parametrize("verb", ["undo", "redo", "name"])
def test_a_scene_that_is_not_there_is_said_to_be_missing(tmp_path, capsys, verb):
    for path in (tmp_path / "a.f4x", tmp_path / "nowhere" / "a.f4x"):
        assert main([verb, str(path)] + ["gizmo", "--text", "square"] * (verb == "name")) == 2
        assert f"{path}: there is no such file" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_what_was_learnt_from_other_gaussians_is_not_written(scene, monkeypatch):
    def add(found, labels, **options):
        write_scene(labelled_scene(features=False), scene)  # somebody else, meanwhile
        return with_vocabulary(found, labels, lambda name: Encoder(), **options)

    monkeypatch.setattr(distilling, "with_vocabulary", add)
    with pytest.raises(F4xError, match="meanwhile"):
        distill(scene, "--vocabulary", "boat")
    assert read_scene(scene).features is None


def test_equal_edits_of_another_writer_all_stay():
    def stack(*operations):
        found = EditStack()
        for operation in operations:
            found = found.append(operation)
        return found

    ours, theirs = stack(Opacity(All(), 0.1)), stack(*[Opacity(All(), 0.9)] * 3)
    merged = merge(EditStack(), ours, theirs)  # the first one's new id is the old one of the second
    assert [edit.operation.factor for edit in merged.edits] == [0.1, 0.9, 0.9, 0.9]
    assert merge(EditStack(), theirs, theirs) == theirs


def test_copies_that_two_made_at_once_both_stay():
    scene = labelled_scene()
    ours = stack_of(scene, Duplicate(Ids.of(scene.ids[:5]), (1, 0, 0)))
    copy = stack_of(scene, Duplicate(Ids.of(scene.ids[5:8]), (0, 1, 0)))
    first = copy.edits[0].operation.first_id
    theirs = stack_of(with_stack(scene, copy), Opacity(Ids.of([first, first + 1]), 0.5)).append(TakeBack(2))
    merged = merge_edits(scene, EditStack(), ours, theirs)
    assert [edit.id for edit in merged.edits] == [1, 2, 3, 4] and merged.edits[3].operation.edit == 3
    assert [edit.enabled for edit in merged.edits] == [True, True, False, True]
    assert merged.edits[2].operation.select == Ids.of([first + 5, first + 6])
    assert len(edited(with_stack(scene, merged)).ids) == len(scene.ids) + 8


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
    monkeypatch.setattr(locking, "PATIENCE", 0.2)
    with locking.only_run("distill", scene), pytest.raises(F4xError, match="another `f4x distill`"):
        distill(scene, "--vocabulary", "boat")


@pytest.mark.parametrize("verb", ["fit", "priors"])
def test_a_second_fit_into_one_folder_is_refused(tmp_path, capsys, verb):
    out = tmp_path / "out"
    with sole_writer(out):
        assert main([verb, str(tmp_path / "clip.mp4"), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"{out}: another fit" in said and said.strip().count("\n") == 0
    assert not out.exists()


def test_a_folder_that_nothing_was_written_into_goes_again(tmp_path):
    with pytest.raises(ZeroDivisionError), sole_writer(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    with sole_writer(tmp_path / "a"):
        Path(tmp_path / "a" / "scene.f4x").touch()
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["scene.f4x"]
