"""Running a batch on this machine: order, failures, what is kept, Ctrl-C, stores, and the lock."""

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pytest
from batch_clips import PROGRAM, STUB, wait_for, write_clips
from PIL import Image
from toy import clip_and_priors

from f4x_core.batch import ray_engine
from f4x_core.batch.index import write_index
from f4x_core.batch.local import LocalEngine
from f4x_core.batch.manifest import Row, read_manifest
from f4x_core.batch.run import DIGESTS, LOCK, Board, clear_old, locked, plan, run_board
from f4x_core.batch.storage import FolderStore, open_store
from f4x_core.batch.work import Attempt, Outcome, Settings, run_task
from f4x_core.cli import batch as cli_batch
from f4x_core.cli import main
from f4x_core.errors import Cancelled, F4xError
from f4x_core.processes import run_child

QUICK = {"paths": "orbit", "parts": "2", "exports": "usd"}


def run(pattern, place, slots=2, defaults=QUICK, **settings):
    """The board after one run."""
    store = open_store(str(place))
    with locked(store):
        board = plan(read_manifest(pattern, defaults), store, remember=True)
        engine = LocalEngine(Settings(store.url, program=STUB, **settings), slots)
        run_board(board, engine, lambda board: None, begins=partial(clear_old, store))
    return board


def contents(folder):
    """Published files but logs and records -> bytes."""
    files = [file for file in Path(folder).rglob("*") if file.is_file()]
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in files
        if not {".batch", "logs"} & set(file.relative_to(folder).parts) and file.name != "index.html"
    }


@pytest.fixture
def stub_cli(monkeypatch):
    monkeypatch.setattr(cli_batch, "Settings", partial(Settings, program=STUB))


def test_rows_leave_the_ordinary_files_and_a_second_run_does_nothing(tmp_path):
    pattern, out = write_clips(tmp_path / "clips", a={}, b={}), tmp_path / "out"
    board = run(pattern, out)
    assert board.counts["render"] == {"done": 4, "waiting": 0, "ready": 0, "running": 0}
    wanted = {"priors/depth.npy", "scene.f4x", "render/orbit/rgb/00000.png", "render/orbit/rgb/00001.png"}
    wanted |= {"export/a-usd.usda"}
    assert set(contents(out / "a")) == wanted
    assert {file.name for file in (out / "a" / "logs").iterdir()} >= {"priors.log", "fit.log", "render_orbit_2_2.log"}
    assert not list((out / ".batch" / "work").iterdir()), "nothing is left of the work"
    before = contents(out)
    again = run(pattern, out)
    assert again.number("kept") == again.number() == 10 and contents(out) == before
    assert again.rows["a"].scores["used_psnr"] == 30


def test_only_what_an_input_changes_is_done_again(tmp_path):
    pattern, out = write_clips(tmp_path / "clips", a={}, b={}), tmp_path / "out"
    run(pattern, out)
    more = run(pattern, out, defaults=QUICK | {"exports": "usd;usd-points"})
    assert (more.number("kept"), more.number("done")) == (10, 2)
    write_clips(tmp_path / "clips", a={"steps": 3})
    changed = run(pattern, out)
    assert set(changed.rows["a"].states.values()) == {"done"} and set(changed.rows["b"].states.values()) == {"kept"}
    (out / "b" / "scene.f4x").unlink()
    for name in "ab":
        shutil.rmtree(out / name / "priors")
    again = run(pattern, out).rows
    assert again["b"].states["fit"] == "done", "a file that somebody removed is made again"
    assert again["b"].states["priors"] == "done" and set(again["a"].states.values()) == {"kept"}, "for a fit alone"


def test_nothing_old_lies_beside_what_is_new(tmp_path):
    pattern, out = write_clips(tmp_path / "clips", a={}, b={}), tmp_path / "out"
    run(pattern, out)
    (out / "a" / "mine.txt").write_text("of a person")
    of_b = contents(out / "b")
    only_a, saved = pattern.replace("*", "a"), out / "a" / ".batch" / "distill" / "saved.json"
    record = out / "a" / ".batch" / "export_usd.json"
    old = json.loads(record.read_text()) | {"of another version": 1}
    record.write_text(json.dumps({name: value for name, value in old.items() if name != "note"}))
    saved.parent.mkdir()
    saved.touch()
    board = run(only_a, out, defaults={"exports": "ply"})
    kept = {"mine.txt", "priors/depth.npy", "scene.f4x"}
    assert set(contents(out / "a")) == kept | {"render/original/rgb/00000.png", "export/ply/name_0000.ply"}
    assert not (out / "a" / "render" / "orbit").exists() and not saved.exists(), "nobody asks for them any more"
    assert board.rows["a"].states["fit"] == "kept" and [other.row.name for other in board.others] == ["b"]
    write_clips(tmp_path / "clips", a={"fail": {"fit": "too blue"}})
    run(only_a, out, defaults={"exports": "ply"})
    assert set(contents(out / "a")) == {"mine.txt", "priors/depth.npy"}, "nor what a failed fit was the source of"
    assert contents(out / "b") == of_b, "which is no row of that list"


def test_a_slip_that_is_stopped_soon_costs_the_rows_at_work(tmp_path):
    """Another profile makes everything anew; what lies in the rows that were not reached stays."""
    pattern, out = write_clips(tmp_path / "clips", a={}, b={}), tmp_path / "out"
    run(pattern, out)
    of_b = contents(out / "b")

    class Stopped(LocalEngine):
        def start(self, task):
            raise KeyboardInterrupt

    store = open_store(str(out))
    board = plan(read_manifest(pattern, {**QUICK, "profile": "wild", "width": "64"}), store)
    with pytest.raises(KeyboardInterrupt):
        run_board(
            board, Stopped(Settings(store.url, program=STUB), 1), lambda _: None, begins=partial(clear_old, store)
        )
    assert contents(out / "b") == of_b and not contents(out / "a")


def test_one_bad_clip_never_stops_the_others(tmp_path, stub_cli, capsys):
    pattern = write_clips(
        tmp_path / "clips",
        a={"note": {"fit": "2 shots"}},
        blue={"fail": {"fit": "the sky is <too> blue"}},
        big={"die": {"priors": 9}},
        z={},
    )
    out = tmp_path / "out"
    code = main(["batch", pattern, "-o", str(out), "--json", "--jobs", "2"])
    result = json.loads(capsys.readouterr().out)
    assert code == 2 == len(result["failed"]) and result["done"] == 2
    assert result["failed"]["blue"] == {"fit": "the sky is <too> blue"}
    assert "ended by signal 9" in result["failed"]["big"]["priors"]
    page = (out / "index.html").read_text()
    assert "the sky is &lt;too&gt; blue" in page and "2 of 4 clips are done, 2 failed" in page
    assert 'src="a/render/original/rgb/00000.png"' in page and 'href="blue/logs/fit.log"' in page
    assert result["notes"] == {"a": {"fit": "2 shots"}}, "which is no failure"
    main(["batch", pattern, "-o", str(out), "--dry-run", "--json"])
    planned = json.loads(capsys.readouterr().out)
    states = {task["stage"]: task["state"] for task in planned["rows"][2]["tasks"]}
    assert states == {"priors": "kept", "fit": "failed", "render original 1/1": "waiting"}
    assert planned["rows"][2]["errors"] == result["failed"]["blue"] and planned["seconds_left"] > 0
    write_clips(tmp_path / "clips", blue={}, big={})
    assert main(["batch", pattern, "-o", str(out)]) == 0, "failed rows are tried again"
    assert capsys.readouterr().out.startswith("a, fit: 2 shots\n4 of 4 clips are done"), "told from its record, too"


def test_a_clip_that_is_not_there_is_a_failed_row(tmp_path):
    table = tmp_path / "list.csv"
    write_clips(tmp_path, a={})
    table.write_text("clip\na.clip\nabsent.clip\n")
    board = run(str(table), tmp_path / "out")
    assert board.rows["a"].state == "done" and board.rows["absent"].state == "failed"


def write_renders(folder, count=2):
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number}.png").touch()
    return str(folder)


def test_a_dry_run_touches_nothing(tmp_path, capsys):
    clip = write_renders(tmp_path / "clips" / "a")
    assert main(["batch", clip, "-o", str(tmp_path / "out"), "--dry-run", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (
        result["to_do"] == result["tasks"] == 3
        and result["seconds_left"] is None
        and result["rows"][0]["tasks"][1]["stage"] == "fit"
    )
    assert not (tmp_path / "out").exists()


def test_a_dry_run_names_what_is_missing_or_not_as_it_is_said(tmp_path, capsys):
    write_renders(tmp_path / "a")
    table = tmp_path / "list.csv"
    table.write_text("clip,name,frames\na,a,\na,long,0:900\nabsent.mp4,,\n")
    assert main(["batch", str(table), "-o", str(tmp_path / "out"), "--dry-run"]) == 2
    result = capsys.readouterr().out
    assert "absent.mp4 is missing" in result and "a is missing" not in result
    assert "long: " in result and "frames 0:900 reach beyond" in result


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--set", "profile=quik"], "row a, priors: argument --profile: there is no 'quik'; did you mean 'quick'?"),
        (["--set", "settings=stepz=6"], "row a, fit: There is no setting 'stepz'; did you mean steps?"),
        (["--set", "settings=seed=1; steps=many"], "row a, fit: steps must be a whole number"),
        (["--set", "profil=quick"], "no column 'profil', near it is 'profile'"),
        (["--set", "profile"], "write COLUMN=VALUE"),
        (["--jobs", "0"], "--jobs 0: give 1 or more"),
        (["--jobs", "2", "--ray", "auto"], "not allowed with"),
        (["--ray", "nowhere"], "--ray nowhere: write HOST:PORT"),
        (["--ray", "127.0.0.1:9"], "--ray 127.0.0.1:9: nobody answers there"),
    ],
)
def test_bad_input_is_one_sentence_before_any_work(tmp_path, capsys, arguments, sentence):
    if "nowhere" in arguments or "127.0.0.1:9" in arguments:
        pytest.importorskip("ray", reason="ray is not installed")
    pattern = write_clips(tmp_path / "clips", a={})
    assert main(["batch", pattern, "-o", str(tmp_path / "out"), *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert contents(tmp_path / "out") == {}


def test_without_ray_on_this_machine_the_option_that_exists_is_named(monkeypatch):
    def init(**_):
        raise ConnectionError("Could not find any running Ray instance. Please specify the one by setting `--address`.")

    monkeypatch.setattr(ray_engine, "import_module", lambda name: SimpleNamespace(init=init))
    with pytest.raises(F4xError, match=r"^--ray auto: Could not .* Ray instance; start Ray by .* HOST:PORT\.$"):
        ray_engine.connect("auto")


def test_the_last_words_of_a_stopped_command_are_in_its_log(tmp_path):
    class SlowLog(list):
        def write(self, line):
            time.sleep(0.002)
            self.append(int(line))

    def stop(_):
        raise Cancelled

    code, log = "import sys; sys.stdin.read(); [print(number, file=sys.stderr) for number in range(100)]", SlowLog()
    with pytest.raises(Cancelled):
        run_child([sys.executable, "-c", code], tmp_path, tick=stop, log=log)
    assert log == list(range(100))


@pytest.mark.parametrize("more", [{}, {"window": "60"}], ids=["at once", "in windows"])
def test_a_stopped_fit_goes_on_from_its_checkpoint_with_the_same_result(tmp_path, more):
    defaults = QUICK | more
    pattern = write_clips(tmp_path / "clips", a={"steps": 20, "seconds": 0})
    whole = contents(run(pattern, tmp_path / "whole", defaults=defaults) and tmp_path / "whole")
    write_clips(tmp_path / "slow", a={"steps": 20, "seconds": 0})  # equal content, equal keys
    out, store = tmp_path / "out", open_store(str(tmp_path / "out"))
    (row,) = read_manifest(pattern, defaults)
    board = plan([row], store)
    *priors, fit = (task for task in board.rows["a"].tasks if task.kind in ("priors", "fit"))
    settings = Settings(store.url, program=STUB, save_every=0.0)
    assert [run_task(task, settings).state for task in priors] == ["done"] * (not more)
    steps = []

    def progress(stage, done, total, message=""):
        steps.append(done)

    stopped = run_task(fit, settings, progress, lambda: len(steps) >= 1 and steps[-1] >= 1)
    assert stopped.state == "stopped" and not (out / "a" / "scene.f4x").exists()
    assert [*(out / "a" / ".batch" / "fit").rglob("checkpoints/photometric.pt")]
    spent = json.loads((out / "a" / ".batch" / "fit" / "saved.json").read_text())["cpu_seconds"]
    done = run_task(fit, settings)
    assert done.cpu_seconds > spent == stopped.cpu_seconds > 0, "a stopped attempt has cost something, too"
    assert done.state == "done" and done.attempts == 2 and done.results[0]["metrics"]["first_step"] > 0
    assert not (out / "a" / ".batch" / "fit" / "saved.json").exists()
    assert run(pattern, out, defaults=defaults).rows["a"].state == "done" and contents(out) == whole


def test_what_a_finished_window_removes_is_not_brought_back(tmp_path):
    (row,) = read_manifest(write_clips(tmp_path / "clips", a={}), QUICK | {"window": "60"})
    store, work = open_store(str(tmp_path / "out")), tmp_path / "work"
    attempt = Attempt(plan([row], store).rows["a"].tasks[0], Settings(store.url))
    saved = []
    for name in ("checkpoints/photometric.pt", "scene.f4x"):
        path = work / "windows" / "000" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        attempt._save(work)
        saved.append(json.loads(store.read("a/.batch/fit/saved.json"))["files"])
        shutil.rmtree(path.parent)
    assert saved == [["windows/000/checkpoints/photometric.pt"], ["windows/000/scene.f4x"]]


def test_what_was_saved_for_other_inputs_is_not_taken(tmp_path):
    pattern = write_clips(tmp_path / "clips", a={"steps": 4})
    store = open_store(str(tmp_path / "out"))
    run(pattern, tmp_path / "out")
    (row,) = read_manifest(pattern, QUICK)
    fit = plan([replace(row, seed=1)], store).rows["a"].tasks[1]
    store.write("a/.batch/fit/checkpoints/photometric.pt", b'[4, "another"]')
    head = {
        "key": "of another fit",
        "attempts": 1,
        "seconds": 0,
        "cpu_seconds": 0,
        "files": ["checkpoints/photometric.pt"],
    }
    store.write("a/.batch/fit/saved.json", json.dumps(head).encode())
    done = run_task(fit, Settings(store.url, program=STUB))
    assert done.results[0]["metrics"]["first_step"] == 0 and done.attempts == 1


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.skipif(os.name == "nt", reason="no SIGINT for one process there")
def test_ctrl_c_ends_at_once_and_the_same_command_goes_on(tmp_path):
    pattern, out = write_clips(tmp_path / "clips", a={"steps": 40, "seconds": 4}, b={}), tmp_path / "out"
    command = [sys.executable, "-c", PROGRAM, "batch", pattern, "-o", str(out), "--jobs", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    saved = out / "a" / ".batch" / "fit" / "saved.json"
    wait_for(saved.exists)
    process.send_signal(signal.SIGINT)
    start = time.monotonic()
    assert process.wait(10) == 130 and time.monotonic() - start < 6
    assert "the same command continues" in process.stderr.read()
    assert not (out / LOCK).exists() and saved.exists() and (out / "index.html").exists()
    write_clips(tmp_path / "quick", a={})
    board = run(pattern, out, defaults={})
    assert board.rows["a"].state == "done" and board.rows["a"].scores["first_step"] > 0


def test_two_batches_cannot_write_into_one_folder(tmp_path, capsys):
    pattern, out = write_clips(tmp_path / "clips", a={}), tmp_path / "out"
    with locked(open_store(str(out))):
        assert main(["batch", pattern, "-o", str(out)]) == 2
        assert "another batch (process" in capsys.readouterr().err
    assert not (out / LOCK).exists()


@pytest.mark.parametrize("holder", ["a dead process", "silent for long", "damaged"])
def test_the_lock_of_a_dead_batch_is_taken_over(tmp_path, holder):
    store = open_store(str(tmp_path))
    import socket

    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    mine = {"host": socket.gethostname(), "pid": dead.pid, "token": "", "beat": time.time()}
    if holder == "silent for long":
        mine |= {"host": "another", "beat": time.time() - 1000}
    store.write(LOCK, b"{" if holder == "damaged" else json.dumps(mine).encode())
    with locked(store):
        assert json.loads(store.read(LOCK))["pid"] == os.getpid()


@pytest.fixture
def memory(monkeypatch):
    """fsspec's file system in memory. Its readers of a file share one position, so two threads would get a part each."""
    system = pytest.importorskip("fsspec", reason="fsspec is not installed").filesystem("memory")

    def get_file(self, path, to, **_):
        Path(to).write_bytes(self.cat_file(path))

    monkeypatch.setattr(type(system), "get_file", get_file)  # of the class: every thread has an instance of its own
    return system


def test_a_store_behind_a_url_gets_the_same_files(tmp_path, memory):
    pattern = write_clips(tmp_path / "clips", a={"steps": 5}, b={})
    whole = contents(run(pattern, tmp_path / "whole") and tmp_path / "whole")
    place = f"memory://{tmp_path.name}"
    board = run(pattern, place)
    store = open_store(place)
    published = {
        name for each in board.rows for name in store.sizes(each) if "/.batch/" not in name and "/logs/" not in name
    }
    assert published == set(whole) and all(store.read(name) == whole[name] for name in published)
    assert run(pattern, place).number("kept") == 10
    with locked(store), pytest.raises(F4xError, match="another batch"), locked(open_store(place)):
        pass
    clip = f"memory://{tmp_path.name}-clips/a.clip"
    memory.pipe_file(clip.removeprefix("memory:/"), (tmp_path / "clips" / "a.clip").read_bytes())
    board = run(clip, tmp_path / "out")
    assert board.rows["a"].state == "done" and board.rows["a"].row.clip.startswith("memory://")
    assert (tmp_path / "out" / "a" / "scene.f4x").read_bytes() == whole["a/scene.f4x"]


def test_a_store_of_real_folders_behind_a_url_makes_them(tmp_path):
    pytest.importorskip("fsspec", reason="fsspec is not installed")
    store = open_store(f"file://{tmp_path}/new/store")
    assert store.folders() == [] and store.create("a/.batch/lock", b"1") and not store.create("a/.batch/lock", b"2")
    store.write("b/c/d", b"34")
    assert store.folders() == ["a", "b"] and store.sizes("") == {"a/.batch/lock": 1, "b/c/d": 2}


def test_a_url_of_an_unknown_kind_is_one_sentence():
    pytest.importorskip("fsspec", reason="fsspec is not installed")
    with pytest.raises(F4xError, match="nowhere://x: "):
        open_store("nowhere://x")


def test_a_full_disk_fails_the_task_and_loses_nothing(tmp_path, monkeypatch):
    pattern, out = write_clips(tmp_path / "clips", a={}, b={}), tmp_path / "out"
    publish = FolderStore.publish

    def full(self, path, name):
        if name == "a/scene.f4x":
            raise OSError(28, "No space left on device", str(path))
        publish(self, path, name)

    monkeypatch.setattr(FolderStore, "publish", full)
    board = run(pattern, out)
    assert board.rows["b"].state == "done" and board.rows["a"].states["priors"] == "done"
    assert "No space left on device; make room there" in board.rows["a"].errors["fit"]
    monkeypatch.undo()
    again = run(pattern, out)
    assert again.rows["a"].states == {"priors": "kept"} | dict.fromkeys(list(again.rows["a"].states)[1:], "done")


def test_a_log_gets_a_line_for_every_task_that_ended(tmp_path, stub_cli, capsys, monkeypatch):
    monkeypatch.setattr(cli_batch, "why_slow", lambda: "No compiled kernels.")
    pattern = write_clips(tmp_path / "clips", a={"fail": {"fit": "the sky is [too] blue"}})
    assert main(["batch", pattern, "-o", str(tmp_path / "out")]) == 1
    slow, *lines = capsys.readouterr().err.splitlines()
    assert slow == "No compiled kernels."
    times, said = zip(*(line.split(" ", 1) for line in lines), strict=True)
    assert all(time.strptime(result, "%H:%M:%S") for result in times)
    assert said[0] == "reading clips" and said[1].startswith("a, priors: done in ")
    assert said[1].endswith(" s, 1 of 3") and said[2].endswith(" s, 3 of 3: the sky is [too] blue") and len(said) == 3


def test_slots_are_used_and_never_more(tmp_path):
    names = {f"c{number}": {"steps": 1, "seconds": 0.3} for number in range(4)}
    pattern = write_clips(tmp_path / "clips", **names)
    store, most = open_store(str(tmp_path / "out")), []
    board = plan(read_manifest(pattern, {"paths": "none"}), store)
    engine = LocalEngine(Settings(store.url, program=STUB), 3)
    run_board(board, engine, lambda board: most.append(board.number("running")))
    assert max(most) == 3 and all(each.state == "done" for each in board.rows.values())
    assert threading.active_count() < 10


def test_the_table_shows_rows_at_work_and_what_failed(tmp_path):
    from rich.console import Console

    pattern = write_clips(tmp_path / "clips", a={"steps": 8, "seconds": 0.8}, b={"fail": {"fit": "no"}})
    store = open_store(str(tmp_path / "out"))
    board = plan(read_manifest(pattern, QUICK), store)
    engine, seen = LocalEngine(Settings(store.url, program=STUB), 2), []

    def watch(board):
        console = Console(width=100, record=True, file=io.StringIO())
        console.print(cli_batch.status_table(board, engine))
        seen.append(console.export_text())

    run_board(board, engine, watch)
    assert any("fit" in text and "%" in text.split("clip", 1)[1] for text in seen)
    assert "1 of 2 clips, 1 failed" in seen[-1] and "✗" in seen[-1]
    assert board.eta() == 0


def test_the_page_of_a_thousand_rows_is_small_and_escapes(tmp_path):
    rows = [Row(f"<b>{number}.mp4", f"row{number}") for number in range(1000)]
    store = open_store(str(tmp_path))
    board = plan(rows, store)
    write_index(store, board, "a <title>")
    page = (tmp_path / "index.html").read_text()
    assert len(page) < 1_000_000 and "<b>" not in page and "a &lt;title&gt;" in page and page.count("<tr>") > 1000
    assert not (tmp_path / DIGESTS).exists()


def test_the_page_shows_what_a_clip_became_and_links_what_is_there(tmp_path):
    row = Row(
        "a.mp4", "a", features=("text",), queries=("dog",), edits=("grey",), parts=2, exports=("ply",), profile="quick"
    )
    left = {
        "priors": {"input.jpg", "priors/depth.npy"},
        "fit": {"scene.f4x", "diagnostics.html"},
        "distill": {"distilled.f4x", "features/text/maps.npy"},
        "query dog": {"query/dog/selection.json", "query/dog/mask/00003.png", "query/dog/mask/00004.png"},
        "edit": {"edited.f4x"},
        "render original 1/2": {f"render/original/rgb/{number:05d}.png" for number in range(4)},
        "render original 2/2": {f"render/original/rgb/{number:05d}.png" for number in range(4, 9)},
    }
    results = {"priors": {"frames": 9, "width": 480, "height": 270}}
    results["fit"] = {"metrics": {"used_psnr": 25.7}, "quality": "poor"}
    store = open_store(str(tmp_path))
    board = plan([row, Row("b.mp4", "b")], store)
    for task in board.rows["a"].tasks:
        names = left.get(task.stage, set())
        for name in (*names, f"logs/{task.slug}.log"):
            store.write(f"a/{name}", b"x")
        result = {"host": "h", "results": (results.get(task.stage, {}),), "files": dict.fromkeys(names, 1)}
        note = "nothing answers" if "query" in task.stage else ""
        board.finish(task, Outcome("a", task.stage, task.key, "done" if names else "failed", note=note, **result))
        store.write(
            f"other/.batch/{task.slug}.json", json.dumps(asdict(Outcome("other", task.stage, "", "done"))).encode()
        )
    board = Board(list(board.rows.values()), plan([row], store, remember=True).others)
    write_index(store, board, "clips")
    text = (tmp_path / "index.html").read_text()
    links = {unquote(link) for link in re.findall(r'(?:href|src)="([^"]*)"', text)}
    assert all((tmp_path / link).exists() for link in links), "no dead links"
    shown = {"input.jpg", "diagnostics.html", "edited.f4x", "query/dog/mask/00004.png", "render/original/rgb/00004.png"}
    assert {f"a/{name}" for name in (*shown, "logs/fit.log", "logs/export_ply.log", "")} <= links
    assert "9 frames of 480×270" in text and '25.7<br><span class="poor">poor</span>' in text and "quick" in text
    assert "query dog: nothing answers" in text and "20" in text.split("Written ")[1][:4]
    assert text.count('class="other"') == 1 and "not in this list" in text


@pytest.mark.slow
def test_a_real_clip_end_to_end(tmp_path, capsys):
    clip, _ = clip_and_priors(frames=6)
    folder = tmp_path / "clip" / "images"
    folder.mkdir(parents=True)
    for index, frame in enumerate(clip.frames):
        Image.fromarray(frame).save(folder / f"{index:03d}.png")
    (tmp_path / "list.csv").write_text("clip,edits,parts,exports\nclip/images,make everything grey,2,ply\n")
    out = tmp_path / "out"
    code = main(["batch", str(tmp_path / "list.csv"), "-o", str(out), "--set", "profile=quick", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == 0, result
    pictures = sorted((out / "clip" / "render" / "original" / "rgb").iterdir())
    assert [file.name for file in pictures] == [f"{index:05d}.png" for index in range(6)]
    picture = np.asarray(Image.open(pictures[0])).astype(int)
    assert np.abs(picture - picture.mean(-1, keepdims=True)).max() < 30, "the edit is in the picture"
    assert len(list((out / "clip" / "export" / "ply").iterdir())) == 6
    whole = tmp_path / "whole"
    assert main(["render", str(out / "clip" / "edited.f4x"), "-o", str(whole), "--json"]) == 0
    assert [file.read_bytes() for file in sorted((whole / "rgb").iterdir())] == [file.read_bytes() for file in pictures]
    assert "PSNR" in (out / "index.html").read_text()
