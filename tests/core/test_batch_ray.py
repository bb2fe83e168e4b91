"""A batch on a Ray cluster of two nodes, both on this machine's loopback, started and stopped here."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from functools import cache
from pathlib import Path

import pytest
from batch_clips import PROGRAM, STUB, wait_for, write_clips

from f4x_core.batch import ray_engine
from f4x_core.batch.local import LocalEngine
from f4x_core.batch.manifest import read_manifest
from f4x_core.batch.run import locked, plan, run_board
from f4x_core.batch.storage import open_store
from f4x_core.batch.work import Settings
from f4x_core.errors import F4xError

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for workers in /proc")]
ray = pytest.importorskip("ray", reason="ray is not installed")
NODE = {"num_cpus": 1, "object_store_memory": 80_000_000, "memory": 4 << 30, "include_dashboard": False}
LOOPBACK = "127.0.0.2"
"""Not .1: Ray would put the machine's outer address in its place."""
ROWS = {"paths": "none"}


@pytest.fixture(scope="module")
def cluster():
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args=NODE | {"node_ip_address": LOOPBACK})
    made.add_node(**NODE, node_ip_address=LOOPBACK)
    made.wait_for_nodes()
    yield made
    made.shutdown()


@pytest.fixture(autouse=True)
def fresh_version():
    """The code is read again: somebody may have worked on it since the last test."""
    ray_engine.code_version.cache_clear()


def run(cluster, pattern, place, disturb=None, defaults=ROWS):
    """The board after a run on the cluster, during which `disturb()` is called once in a thread of its own."""
    store = open_store(str(place))
    with locked(store):
        board = plan(read_manifest(pattern, defaults), store)
        settings = Settings(store.url, program=STUB, save_every=0.1)
        tasks = [task for each in board.rows.values() for task in each.tasks]
        with ray_engine.RayEngine(settings, cluster.address, tasks) as engine:
            thread = threading.Thread(target=disturb or (lambda: None))
            thread.start()
            run_board(board, engine, lambda board: None)
            thread.join()
    return board


def undisturbed(pattern, place, defaults=ROWS):
    """Scenes of a run without a cluster."""
    store = open_store(str(place))
    board = plan(read_manifest(pattern, defaults), store)
    run_board(board, LocalEngine(Settings(store.url, program=STUB), 2), lambda board: None)
    return scenes(place)


def scenes(place):
    return {file.parent.name: file.read_bytes() for file in Path(place).glob("*/scene.f4x")}


def parent_of(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def fits_at_work():
    """Parent process -> child process of every stub that pretends to fit, among descendants of this process's user."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            if b"benchmarks.speed.batch_stub" in words and b"fit" in words:
                found[parent_of(entry.name)] = int(entry.name)
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def test_rows_finish_and_logs_come_home(cluster, tmp_path):
    pattern = write_clips(tmp_path / "clips", a={}, b={}, c={"fail": {"fit": "the sky is too blue"}})
    board = run(cluster, pattern, tmp_path / "out", defaults={"parts": "2"})
    assert [each.state for each in board.rows.values()] == ["done", "done", "failed"]
    assert board.rows["c"].errors == {"fit": "the sky is too blue"}
    assert "stub fit" in (tmp_path / "out" / "c" / "logs" / "fit.log").read_text()
    assert scenes(tmp_path / "out") == undisturbed(pattern, tmp_path / "whole", {"parts": "2"})


def test_a_killed_worker_and_a_killed_node_lose_nothing(cluster, tmp_path):
    clips = {f"c{number}": {"steps": 50, "seconds": 5} for number in range(4)}
    pattern, out = write_clips(tmp_path / "clips", **clips), tmp_path / "out"
    extra = cluster.add_node(**NODE, node_ip_address=LOOPBACK)
    cluster.wait_for_nodes()

    def saved():
        return len(list(out.glob("*/.batch/fit/saved.json")))

    def disturb():
        wait_for(lambda: len(fits_at_work()) >= 2 and saved() >= 2)
        os.kill(min(fits_at_work()), signal.SIGKILL)
        time.sleep(1)
        wait_for(lambda: fits_at_work() and saved())
        cluster.remove_node(extra, allow_graceful=False)

    board = run(cluster, pattern, out, disturb)
    assert [each.state for each in board.rows.values()] == ["done"] * 4
    resumed = [name for name, each in board.rows.items() if each.scores["first_step"] > 0]
    assert resumed, "somebody went on from a checkpoint"
    assert scenes(out) == undisturbed(pattern, tmp_path / "whole")
    assert not fits_at_work(), "no child outlives its worker"


def test_a_node_with_another_version_is_told_before_any_work(cluster, tmp_path, monkeypatch):
    pattern = write_clips(tmp_path / "clips", a={})
    monkeypatch.setattr(ray_engine, "code_version", cache(lambda: "0.0.1 (abc)"))
    with pytest.raises(F4xError, match=r"node .* has Feature4X .*, this machine 0\.0\.1 \(abc\); install the same"):
        run(cluster, pattern, tmp_path / "out")
    assert not ray.is_initialized() and not scenes(tmp_path / "out")


def test_a_node_that_draws_with_something_else_is_told_where_that_matters(cluster, tmp_path, monkeypatch):
    pattern = write_clips(tmp_path / "clips", a={})
    monkeypatch.setattr(ray_engine, "choose_backend", lambda backend: "another")
    with pytest.raises(
        F4xError, match=r"node .* would draw with .*, this machine with another, .*; compile the kernels"
    ):
        run(cluster, pattern, tmp_path / "out")
    assert run(cluster, pattern, tmp_path / "out", defaults=ROWS | {"backend": "torch"}).rows["a"].state == "done"


def test_a_node_that_is_too_busy_to_answer_is_told(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_engine, "PROBE_PATIENCE", 0.0)
    with pytest.raises(F4xError, match="did not answer within 0 seconds; it may be busy: give the same command again"):
        ray_engine.RayEngine(Settings(str(tmp_path)), cluster.address)


def test_a_node_that_does_not_see_the_folder_is_told(cluster, tmp_path):
    with pytest.raises(F4xError, match=r"does not see .*; choose a folder that all machines share"):
        ray_engine.RayEngine(Settings(str(tmp_path / "not there")), cluster.address)
    assert not ray.is_initialized()


def test_a_task_that_fits_on_no_node_is_told(cluster, tmp_path):
    pattern = write_clips(tmp_path / "clips", a={})
    with pytest.raises(F4xError, match="a: no node of the cluster has 64 cores, 1 GB"):
        run(cluster, pattern, tmp_path / "out", defaults={"threads": "64"})


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_stops_the_work_on_the_nodes_and_the_same_command_goes_on(cluster, tmp_path):
    pattern, out = write_clips(tmp_path / "clips", a={"steps": 60, "seconds": 6}), tmp_path / "out"
    command = [sys.executable, "-c", PROGRAM, "batch", pattern, "-o", str(out), "--ray", cluster.address]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_for((out / "a" / ".batch" / "fit" / "saved.json").exists)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    assert "the same command continues" in process.stderr.read()
    wait_for(lambda: not fits_at_work(), 10)
    process = subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    os.kill(min(wait_for(fits_at_work)), signal.SIGKILL)
    message, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert json.loads(message)["done"] == 1, "and nothing of what Ray says of the dead worker"
    record = json.loads((out / "a" / ".batch" / "fit.json").read_text())
    assert record["attempts"] >= 2 and record["results"][0]["metrics"]["first_step"] > 0
