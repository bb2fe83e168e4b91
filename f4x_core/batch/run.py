"""Running a batch: which tasks are ready, the outcome of each, and a lock so that only one batch writes into a store."""

from __future__ import annotations

import contextlib
import heapq
import json
import os
import re
import shutil
import socket
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import PurePosixPath
from typing import Any, Protocol

from ..errors import F4xError
from ..reading import parse_json
from ..report.input_picture import INPUT
from .graph import KINDS, Task, tasks_of
from .manifest import Row
from .storage import Digests, Store
from .work import STATE, Outcome, parse_record, record_name

LINKED = {
    "fit": {"diagnostics": "diagnostics.html", "scene": "scene.f4x"},
    "distill": {"scene": "distilled.f4x"},
    "edit": {"scene": "edited.f4x"},
}
"""Stage -> link text in the index -> file; the scene of a later stage replaces that of an earlier one."""
LOCK, DIGESTS = f"{STATE}/lock.json", f"{STATE}/digests.json"
BEAT, STALE = 10.0, 60.0
"""Seconds between two updates of the lock, and seconds without an update after which its batch counts as dead."""
READERS = 16
"""Number of rows whose records are read in parallel, since a store behind a URL has a high latency."""
LOOK = 0.2
"""Seconds to wait for an engine before the table is drawn again."""
WAITING, READY, RUNNING, DONE, KEPT = "waiting", "ready", "running", "done", "kept"
FAILED, SKIPPED, STOPPED = "failed", "skipped", "stopped"
"""States of a task; `kept` means done in an earlier run, `skipped` means that a task it needs has failed."""


class Engine(Protocol):
    """Runs tasks, on this machine or on a cluster."""

    slots: int
    """Maximum number of tasks that it accepts at a time."""

    def start(self, task: Task) -> None:
        """Start a task without waiting for it."""

    def finished(self, timeout: float) -> list[tuple[Task, Outcome]]:
        """Return tasks that have ended, after waiting up to `timeout` seconds for the first."""

    def progress(self) -> dict[tuple[str, str], tuple[str, int, int]]:
        """Return (row, stage) -> (step, done, total) of running tasks, as far as known."""

    def stop(self) -> list[tuple[Task, Outcome]]:
        """Stop all running tasks, as after Ctrl-C, and return their outcomes."""


@dataclass
class RowState:
    """The state of one row, small enough to keep thousands in memory."""

    row: Row
    """The row of the manifest."""
    tasks: tuple[Task, ...]
    """In order, each after the tasks that it needs."""
    states: dict[str, str] = field(default_factory=dict)
    """Stage -> state."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Stage -> wall time of its commands."""
    errors: dict[str, str] = field(default_factory=dict)
    """Stage -> why it failed."""
    notes: dict[str, str] = field(default_factory=dict)
    """Stage -> what a person should know about it although it succeeded."""
    scores: dict[str, float] = field(default_factory=dict)
    """Scores of the fit."""
    quality: str = ""
    """The fit's verdict: good, usable with limits, poor."""
    size: tuple[int, int, int] | None = None
    """Number of frames, width and height of the fitted clip."""
    input: str = ""
    """File with an image of the clip."""
    files: dict[str, str] = field(default_factory=dict)
    """Link text in the index -> file: diagnostics, scene, the most telling file of every query, render (all parts) and export."""
    logs: tuple[str, ...] = ()
    """Stages that have a log."""
    missing: tuple[str, ...] = ()
    """Paths that it reads and that do not exist."""
    old: tuple[str, ...] = ()
    """Files in the store that earlier runs made and this run does not keep."""

    @property
    def state(self) -> str:
        """State of the whole row: failed, done, running or waiting."""
        states = set(self.states.values())
        if FAILED in states:
            return FAILED
        if states <= {DONE, KEPT}:
            return DONE
        return RUNNING if RUNNING in states else WAITING

    def record(self, outcome: Outcome) -> None:
        """Store the parts of an outcome that the index and the table show."""
        stage = outcome.stage
        self.seconds[stage] = outcome.seconds
        self.errors.pop(stage, None)
        if outcome.error:
            self.errors[stage] = outcome.error
        if outcome.note:
            self.notes[stage] = outcome.note
        if outcome.host and stage not in self.logs:
            self.logs = (*self.logs, stage)
        result = outcome.results[-1] if outcome.results else {}
        if INPUT in outcome.files and "width" in result:
            self.input, self.size = INPUT, (result["frames"], result["width"], result["height"])
        if stage == "fit":
            metrics = result.get("metrics", {})
            self.scores = {name: value for name, value in metrics.items() if isinstance(value, int | float)}
            self.quality = result.get("quality", "")
        for what, name in LINKED.get(stage, {}).items():
            if name in outcome.files:
                self.files[what] = name
        if stage.startswith(("query", "render", "export")):
            what = re.sub(r" \d+/\d+$", "", stage)
            names = [*filter(None, [self.files.get(what)]), *sorted(outcome.files)]
            if names:
                self.files[what] = max(names, key=self._fitness)

    @property
    def preview_image(self) -> str:
        """The rendered image that represents the row; empty if there is none."""
        found = [file for what, file in self.files.items() if what.startswith("render") and file.endswith(".png")]
        return max(found, key=self._fitness, default="")

    def _fitness(self, name: str) -> tuple[bool, ...]:
        """Sort key of a file by how well it represents the clip: original path, colour, image file, the frame of `input`."""
        path = PurePosixPath(name)
        moment = f"{self.size[0] // 2:05d}" if self.size else ""
        return "original" in path.parts, "rgb" in path.parts, path.suffix == ".png", path.stem == moment


class Board:
    """The states of all rows of a batch. Counts are kept up to date, because the table reads them often."""

    def __init__(self, rows: Sequence[RowState], others: Sequence[RowState] = ()):
        """Count the states of all tasks.

        `rows` are in the order of the manifest; `others` lie in the store and are not in the manifest.
        """
        self.rows = {each.row.name: each for each in rows}
        self.others = tuple(others)
        found = {task.kind for each in rows for task in each.tasks}
        self.kinds = tuple(kind for kind in KINDS if kind in found)
        """Kinds of task in this batch."""
        self.counts = {
            kind: Counter(each.states[t.stage] for each in rows for t in each.tasks if t.kind == kind)
            for kind in self.kinds
        }
        """Kind -> state -> number of tasks."""
        self.times = {kind: (0.0, 0) for kind in self.kinds}
        """Kind -> (total seconds, number) of finished tasks, including those of earlier runs."""
        for each in rows:
            for task in each.tasks:
                if each.states[task.stage] == KEPT:
                    self._count_time(task, each.seconds[task.stage])
        self.slots = 1

    def mark(self, task: Task, state: str) -> None:
        """Put a task into another state."""
        states = self.rows[task.row].states
        self.counts[task.kind][states[task.stage]] -= 1
        self.counts[task.kind][state] += 1
        states[task.stage] = state

    def finish(self, task: Task, outcome: Outcome) -> None:
        """Record the outcome of a task; if it failed, skip the tasks that need it."""
        each = self.rows[task.row]
        self.mark(task, outcome.state)
        each.record(outcome)
        if outcome.state == DONE:
            self._count_time(task, outcome.seconds)
        else:
            self._skip_after(each, task)

    @property
    def failed(self) -> list[RowState]:
        """Rows in which a task failed."""
        return [each for each in self.rows.values() if each.state == FAILED]

    def number(self, *states: str) -> int:
        """Return the number of tasks in one of `states`; of all tasks if no state is given."""
        return sum(
            count for counts in self.counts.values() for state, count in counts.items() if state in (states or counts)
        )

    def eta(self) -> float | None:
        """Estimate the seconds left from the mean time of each kind of task; None until a task of every kind has finished."""
        left = 0.0
        for kind, counts in self.counts.items():
            seconds, ended = self.times[kind]
            to_do = counts[WAITING] + counts[READY] + counts[RUNNING] / 2
            if to_do and not ended:
                return None
            left += to_do * seconds / max(ended, 1)
        return left / self.slots

    def _count_time(self, task: Task, seconds: float) -> None:
        total, number = self.times[task.kind]
        self.times[task.kind] = total + seconds, number + 1

    def _skip_after(self, each: RowState, task: Task) -> None:
        for other in each.tasks:
            if any(stage == task.stage for stage, _ in other.inputs) and each.states[other.stage] == WAITING:
                self.mark(other, SKIPPED)
                self._skip_after(each, other)


def plan(
    rows: Sequence[Row],
    store: Store,
    progress: Callable[[int, int], None] = lambda done, total: None,
    remember: bool = False,
) -> Board:
    """Return the tasks of all rows; tasks that are already done are marked as kept.

    Every clip is read once to compute its hash; with `remember` the store keeps the hashes.
    """
    known = None
    with contextlib.suppress(ValueError):  # damaged: all clips are read again
        known = parse_json(store.read(DIGESTS) or b"{}")
    digests = Digests(known)

    states = []
    with ThreadPoolExecutor(READERS) as pool:
        for done, state in enumerate(pool.map(partial(_state_of, store=store, digests=digests), rows), 1):
            states.append(state)
            progress(done, len(rows))
    if not remember:
        return Board(states)
    store.write(DIGESTS, json.dumps(digests.to_json()).encode())
    others = [_read_other(store, name) for name in store.folders() if name not in {row.name for row in rows}]
    return Board(states, [each for each in others if each.states])


def _state_of(row: Row, store: Store, digests: Digests) -> RowState:
    """Return the tasks of a row, those that are done as kept, and what lies there that none of them made."""
    missing: dict[str, None] = {}

    def digest(path: str) -> str:
        found = digests.digest(path)
        if not found:
            missing[path] = None
        return found

    state = RowState(row, tasks_of(row, digest), missing=tuple(missing))
    sizes = store.sizes(row.name)
    state.states = dict.fromkeys((task.stage for task in state.tasks), WAITING)
    records: list[Outcome] = []
    for task in reversed(state.tasks):
        name = record_name(task)
        record = parse_record(store.read(name)) if name in sizes else None
        if record is None or record.key != task.key:
            continue
        there = all(sizes.get(f"{row.name}/{file}") == size for file, size in record.files.items())
        spare = task.kind == "priors" and state.states["fit"] == KEPT  # which alone reads them: they may be gone
        if record.state == "done" and (there or spare):
            state.states[task.stage] = KEPT
            records.append(record)
        elif record.state == "failed":
            state.errors[task.stage] = record.error
    kept = {f"{row.name}/{file}" for record in records for file in record.files}
    kept |= {record_name(task) for task in state.tasks if state.states[task.stage] == KEPT}
    state.old = tuple(_old_files(store, state, sizes.keys() - kept))
    for record in reversed(records):
        state.record(record)
    return state


def _read_other(store: Store, name: str) -> RowState:
    """Return the state of a folder that is no row of the manifest, from its records; without states if it has none."""
    each = RowState(Row(name, name), ())
    found = [parse_record(store.read(file)) for file in store.sizes(f"{name}/{STATE}") if _is_record(file)]
    records = [record for record in found if record is not None]
    sizes = store.sizes(name) if records else {}
    order = {kind: number for number, kind in enumerate(KINDS)}
    for record in sorted(records, key=lambda record: order.get(record.stage.split(" ")[0], len(order))):
        each.states[record.stage] = KEPT if record.state == DONE else FAILED
        there = {file: size for file, size in record.files.items() if f"{name}/{file}" in sizes}
        each.record(replace(record, files=there))
    return each


def _is_record(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return len(parts) == 3 and parts[1] == STATE


def _old_files(store: Store, each: RowState, names: Set[str]) -> Iterator[str]:
    """Yield the files of `names` that earlier tasks of the row made, or that tasks saved which are no longer in the manifest.

    `names` holds no file of a kept task. The record of a failed task stays while the task is in the manifest, for its error.
    """
    asked = {task.slug for task in each.tasks}
    for name in names:
        path = PurePosixPath(name)
        if _is_record(name):
            record = parse_record(store.read(name))
            files = [f"{each.row.name}/{file}" for file in (record.files if record else ())]
            yield from (file for file in files if file in names)
            if not (record and record.state == FAILED and path.stem in asked):
                yield name
        elif path.parts[1] == STATE and path.parts[2] not in asked:
            yield name


def run_board(
    board: Board,
    engine: Engine,
    watch: Callable[[Board], None],
    ended: Callable[[Board, Outcome], None] = lambda board, outcome: None,
    begins: Callable[[RowState], None] = lambda each: None,
) -> None:
    """Run all waiting tasks. A failure in one row does not affect other rows.

    `watch(board)` is called about five times a second, `ended(board, outcome)` once per task, and `begins(row)` once per row,
    before its first task. KeyboardInterrupt stops the running tasks and is raised again.
    """
    board.slots = engine.slots
    order = {name: number for number, name in enumerate(board.rows)}
    ready: list[tuple[int, int, Task]] = []

    def release(each: RowState) -> None:
        """Queue the tasks of a row whose inputs are all done."""
        for number, task in enumerate(each.tasks):
            if each.states[task.stage] == WAITING and all(
                each.states[stage] in (DONE, KEPT) for stage, _ in task.inputs
            ):
                board.mark(task, READY)
                heapq.heappush(ready, (order[task.row], number, task))

    def finish(outcomes: Sequence[tuple[Task, Outcome]]) -> None:
        for task, outcome in outcomes:
            board.finish(task, outcome)
            ended(board, outcome)

    for each in board.rows.values():
        each.errors.clear()
        release(each)
        if not set(each.states.values()) & {WAITING, READY}:
            begins(each)
    begun: set[str] = set()
    running = 0
    try:
        while ready or running:
            while ready and running < engine.slots:  # early rows first: results come row by row
                task = heapq.heappop(ready)[2]
                if task.row not in begun:
                    begins(board.rows[task.row])
                    begun.add(task.row)
                board.mark(task, RUNNING)
                engine.start(task)
                running += 1
            outcomes = engine.finished(LOOK)
            running -= len(outcomes)
            finish(outcomes)
            for task, _ in outcomes:
                release(board.rows[task.row])
            watch(board)
    except BaseException:
        finish(engine.stop())
        raise


def clear_work(store: Store) -> None:
    """Delete work folders of killed tasks from earlier runs. Only for the holder of the lock."""
    if store.local is not None:
        shutil.rmtree(store.local / STATE / "work", ignore_errors=True)


def clear_old(store: Store, each: RowState) -> None:
    """Delete the files of a row that earlier runs made and this run does not keep, so that no old file lies beside new ones.

    Only files in the records of tasks that run again, or that are no longer in the manifest, are deleted. This happens row by
    row, when the first task of a row starts: a wrong command that is stopped soon costs only the rows that had started.
    """
    for name in each.old:
        store.remove(name)
        if store.local is not None:
            with contextlib.suppress(OSError):  # a folder goes with its last file
                for folder in (store.local / name).parents:
                    folder.rmdir()
    each.old = ()


@contextlib.contextmanager
def locked(store: Store) -> Iterator[None]:
    """Hold the lock of a store. Raises F4xError if another batch holds it."""
    mine = {"host": socket.gethostname(), "pid": os.getpid(), "token": uuid.uuid4().hex}

    def sign() -> bytes:
        return json.dumps(mine | {"beat": time.time()}).encode()

    if not store.create(LOCK, sign()):
        other = _holder(store.read(LOCK))
        if other is not None:
            raise F4xError(
                f"{store.url}: another batch (process {other['pid']} on {other['host']}) writes there; wait for its end, or"
                " choose another folder."
            )
        store.write(LOCK, sign())
    ended = threading.Event()

    def beat() -> None:
        while not ended.wait(BEAT):
            with contextlib.suppress(F4xError, OSError):  # the next beat may come through
                store.write(LOCK, sign())

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        store.remove(LOCK)


def _holder(data: bytes | None) -> dict[str, Any] | None:
    """Return the holder of the lock; None if the lock is gone or its batch is dead."""
    try:
        other = parse_json(data or b"")
        if time.time() - other["beat"] > STALE:
            return None
        if other["host"] == socket.gethostname() and os.name != "nt":
            os.kill(other["pid"], 0)
    except (ValueError, KeyError, TypeError, ProcessLookupError):
        return None
    except PermissionError:  # somebody else's process, which lives
        pass
    return other
