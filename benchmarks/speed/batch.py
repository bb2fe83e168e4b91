"""Costs and gains of the batch layer on this machine: `f4x bench scale`."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from f4x_core.batch.graph import Task
from f4x_core.batch.index import write_index
from f4x_core.batch.local import LocalEngine
from f4x_core.batch.manifest import PAGE, read_manifest
from f4x_core.batch.run import Board, locked, plan, run_board
from f4x_core.batch.storage import open_store
from f4x_core.batch.work import Outcome, Settings, read_record_of
from f4x_core.clip.images import write_images
from f4x_core.errors import F4xError
from f4x_core.progress import Progress, silent

from .batch_cost import Size, fit_costs

STUB = (sys.executable, "-m", "benchmarks.speed.batch_stub")
SIZES = ((8, 64, 40), (12, 64, 40), (8, 96, 60), (16, 80, 48), (12, 96, 60), (10, 112, 64), (16, 64, 40), (20, 96, 60))
"""Frames, width and height of the small clips."""
STAGES = {"priors": "priors", "fit": "fit", "render": "render original 1/1"}
"""Kind -> stage of the tasks that such a clip has."""
QUICK_STEPS = 1200
"""Optimiser steps of the profile `quick`."""
EMPTY = {"paths": "none"}
"""Rows without pictures: priors and fit."""
LOOPBACK = "127.0.0.2"
"""Address of a cluster that nobody else reaches; in place of .1 Ray would put the machine's outer address."""
OBJECT_STORE = 80_000_000
"""Bytes, about the least that Ray takes: it carries nothing but a task's description and what became of it."""


def make_clip(folder: Path, frames: int, width: int, height: int, seed: int) -> None:
    """Write pictures of a textured square that moves in front of a textured wall, seen by a camera that slides."""
    rng = np.random.default_rng(seed)
    wall = _texture(rng, height, width + 2 * frames)
    square = _texture(rng, height // 3, width // 5)
    high, wide = square.shape[:2]

    def image(t: int) -> np.ndarray:
        frame = wall[:, t : t + width].copy()
        left, top = width // 6 + 2 * t, height // 3
        frame[top : top + high, left : left + wide] = square
        return frame

    write_images(folder, (image(t) for t in range(frames)))


def _texture(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Smooth random colours (height,width,3) in [0,1]: sums of waves, which flow can follow."""
    y, x = np.mgrid[:height, :width]
    waves = [
        np.sin(x[..., None] * rng.uniform(0.1, 0.6, 3) + y[..., None] * rng.uniform(0.1, 0.6, 3) + rng.uniform(0, 6, 3))
        for _ in range(5)
    ]
    return np.clip(0.5 + 0.12 * np.sum(waves, 0), 0, 1)


def run_rows(
    pattern: str,
    place: str,
    slots: int,
    defaults: Mapping[str, str],
    program: tuple[str, ...] | None,
    watch: Callable[[Board], None] = lambda board: None,
) -> tuple[Board, float]:
    """One batch in local processes: the board, and wall seconds."""
    store = open_store(place)
    with locked(store):
        start = time.perf_counter()
        board = plan(read_manifest(pattern, defaults), store, remember=True)
        run_board(board, LocalEngine(Settings(store.url, program=program), slots), watch)
        return board, time.perf_counter() - start


def measure_gain(folder: Path, count: int, progress: Progress = silent) -> dict[str, Any]:
    """Small real clips, one thread each, by one worker and by two; and the cost model, each clip predicted from the others.

    The gain is of wall time, and means something where nobody else is at work. `busy` is the share of the workers' time in which
    commands run, `cpu_growth` what a task's CPU time grows by beside another one: both mean something on a busy machine too.
    """
    for number, (frames, width, height) in enumerate(SIZES[:count]):
        make_clip(folder / "clips" / f"clip{number}" / "images", frames, width, height, seed=number)
    seconds, busy, used = {}, {}, {}
    for workers in (1, 2):
        progress("bench scale", 0, 0, f"{count} clips, {workers} at a time")
        place = str(folder / f"by{workers}")
        board, seconds[workers] = run_rows(str(folder / "clips" / "*"), place, workers, {"profile": "quick"}, None)
        bad = [error for each in board.failed for error in each.errors.values()]
        if bad:
            raise F4xError(f"a clip of the measurement failed: {bad[0]}")
        busy[workers] = sum(sum(each.seconds.values()) for each in board.rows.values())
        used[workers] = sum(sum(times.values()) for _, times in cost_rows(Path(place), SIZES[:count]))
    measured = cost_rows(folder / "by1", SIZES[:count])
    return {
        "seconds_1_worker": seconds[1],
        "seconds_2_workers": seconds[2],
        "two_workers_gain": seconds[1] / seconds[2],
        "two_workers_busy": busy[2] / (2 * seconds[2]),
        "two_workers_cpu_growth": used[2] / used[1],
        "cost_coefficients": dict(fit_costs(measured).coefficients),
        "cost_errors": leave_one_out(measured) if count > 4 else [],
    }


def cost_rows(place: Path, sizes: Sequence[tuple[int, int, int]]) -> list[tuple[Size, dict[str, float]]]:
    """Size and CPU seconds by kind of task of the clips of `measure_gain`.

    CPU time, because others may be at work on the machine; with one thread a task it is the wall time of a machine of one's own.
    """
    store, found = open_store(str(place)), []
    for number, (frames, width, height) in enumerate(sizes):
        records = {kind: read_record_of(store, f"clip{number}", stage) for kind, stage in STAGES.items()}
        times = {kind: record.cpu_seconds for kind, record in records.items() if record is not None}
        found.append((Size(frames, width * height / 1e6, QUICK_STEPS), times))
    return found


def leave_one_out(measured: Sequence[tuple[Size, Mapping[str, float]]]) -> list[float]:
    """Relative error of the predicted total time of every clip, from a model of the others."""
    errors = []
    for held_out, (size, times) in enumerate(measured):
        model = fit_costs([*measured[:held_out], *measured[held_out + 1 :]])
        errors.append(model.seconds(size) / sum(times.values()) - 1)
    return errors


def measure_overhead(folder: Path, rows: int = 500) -> dict[str, float]:
    """Seconds that a task takes in a batch beyond its command, with one worker in local processes that do nothing; and whether
    many of them cost more each, commands included: seconds a task and memory of this process, of the first and the last quarter.
    """
    write_stub_clips(folder / "clips", rows)
    samples: list[tuple[int, float, int]] = []

    def watch(board: Board) -> None:
        samples.append((board.number("done"), time.perf_counter(), _resident()))

    board, seconds = run_rows(str(folder / "clips" / "*"), str(folder / "out"), 1, EMPTY, STUB, watch)
    busy = sum(sum(each.seconds.values()) for each in board.rows.values())
    done, moments, memory = np.array(samples, float).T
    tasks = board.number()
    quarters = np.interp(np.array([0, 0.25, 0.75, 1]) * tasks, done, moments)
    return {
        "local_overhead_s": (seconds - busy) / tasks,
        "children": tasks,
        "first_quarter_s_per_child": 4 * (quarters[1] - quarters[0]) / tasks,
        "last_quarter_s_per_child": 4 * (quarters[3] - quarters[2]) / tasks,
        "children_memory_growth_mb": float(memory[-1] - np.interp(0.25 * tasks, done, memory)) / 1e6,
    }


def measure_ray(folder: Path, repeats: int = 10) -> dict[str, float]:
    """The same on a Ray cluster of one core, started here and stopped again."""
    from ray.cluster_utils import Cluster

    from f4x_core.batch.ray_engine import RayEngine

    write_stub_clips(folder / "clips", repeats)
    store = open_store(str(folder / "out"))
    node = {"num_cpus": 1, "include_dashboard": False, "node_ip_address": LOOPBACK, "object_store_memory": OBJECT_STORE}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    try:
        with locked(store):
            board = plan(read_manifest(str(folder / "clips" / "*"), EMPTY), store)
            start = time.perf_counter()
            with RayEngine(Settings(store.url, program=STUB), cluster.address) as engine:
                connected = time.perf_counter()
                run_board(board, engine, lambda board: None)
                seconds = time.perf_counter() - connected
    finally:
        cluster.shutdown()
    busy = sum(sum(each.seconds.values()) for each in board.rows.values())
    return {"ray_overhead_s": (seconds - busy) / board.number(), "ray_connect_s": connected - start}


def measure_growth(folder: Path, rows: int = 1000) -> dict[str, float]:
    """Measure the growth with many rows of tasks that do nothing: seconds a task and memory of the first and the last quarter."""
    write_stub_clips(folder / "clips", rows)
    store = open_store(str(folder / "out"))
    start = time.perf_counter()
    board = plan(read_manifest(str(folder / "clips" / "*"), EMPTY), store)
    planned = time.perf_counter() - start
    engine, moments, memory = Nothing(), [], []

    def watch(board: Board) -> None:
        moments.append(time.perf_counter())
        memory.append(_resident())

    run_board(board, engine, watch)
    quarter = len(moments) // 4
    start = time.perf_counter()
    write_index(store, board, "many rows")
    return {
        "rows": rows,
        "plan_s_per_row": planned / rows,
        "first_quarter_ms_per_task": 1000 * (moments[quarter] - moments[0]) / quarter / Nothing.slots,
        "last_quarter_ms_per_task": 1000 * (moments[-1] - moments[-1 - quarter]) / quarter / Nothing.slots,
        "memory_growth_mb": (memory[-1] - memory[quarter]) / 1e6,
        "index_s": time.perf_counter() - start,
        "index_kb": len(store.read(PAGE) or b"") / 1000,
    }


class Nothing:
    """An `Engine` whose tasks are done at once: what is left is the batch's own work."""

    slots = 2

    def __init__(self) -> None:
        """Nothing waits."""
        self.waiting: list[Task] = []

    def start(self, task: Task) -> None:
        """Take it."""
        self.waiting.append(task)

    def finished(self, timeout: float) -> list[tuple[Task, Outcome]]:
        """All of them."""
        done = [(task, Outcome(task.row, task.stage, task.key, "done")) for task in self.waiting]
        self.waiting = []
        return done

    def progress(self) -> dict[tuple[str, str], tuple[str, int, int]]:
        """None."""
        return {}

    def stop(self) -> list[tuple[Task, Outcome]]:
        """Nothing runs."""
        return []


def write_stub_clips(folder: Path, count: int) -> None:
    """Clips for the stub, each with content of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        (folder / f"clip{number:05d}.json").write_text(json.dumps({"name": number}))


def _resident() -> int:
    """Bytes of memory that this process holds now; where the system does not tell, the most it ever held."""
    import resource  # which Windows lacks

    table = Path("/proc/self/statm")
    if table.exists():
        return int(table.read_text().split()[1]) * resource.getpagesize()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def benchmark(count: int, progress: Progress = silent) -> dict[str, Any]:
    """All of it; `count` small clips, at most eight. What needs Ray is left out where it is not installed."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        progress("bench scale", 0, 0, "a thousand rows that do nothing")
        report = {**measure_growth(folder / "growth"), **measure_overhead(folder / "overhead")}
        if find_spec("ray") is not None:
            progress("bench scale", 0, 0, "a Ray cluster")
            report |= measure_ray(folder / "ray")
        return report | (measure_gain(folder / "gain", count, progress) if count else {})
