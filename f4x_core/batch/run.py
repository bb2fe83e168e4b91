"""Running a batch: which tasks are ready, what became of each, and a lock so that one batch at a time writes into a folder."""

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
from pathlib import PurePosixPath
from typing import Any, Protocol

from ..errors import F4xError
from .graph import KINDS, Task, tasks_of
from .manifest import Row
from .storage import Digests, Store
from .work import STATE, Outcome, parse_record, record_name

INPUT = "input.jpg"
"""The picture of the clip that `f4x priors` leaves, and `f4x fit` where it fits windows."""
LINKED = {
    "fit": {"diagnostics": "diagnostics.html", "scene": "scene.f4x"},
    "distill": {"scene": "distilled.f4x"},
    "edit": {"scene": "edited.f4x"},
}
"""Stage -> what the index links -> file; a later stage's scene is the one to look at."""
LOCK, DIGESTS = f"{STATE}/lock.json", f"{STATE}/digests.json"
BEAT, STALE = 10.0, 60.0
"""Seconds between two signs of life of a batch, and after which it is taken for dead."""
READERS = 16
"""Rows whose records are read at the same time: a store behind a URL answers late."""
LOOK = 0.2
"""Seconds that an engine is waited for before the table is drawn anew."""
WAITING, READY, RUNNING, DONE, KEPT = "waiting", "ready", "running", "done", "kept"
FAILED, SKIPPED, STOPPED = "failed", "skipped", "stopped"
"""States of a task; `kept` was done in an earlier run, `skipped` needs one that failed."""


class Engine(Protocol):
    """Something that works on tasks."""

    slots: int
    """Tasks that it takes at a time."""

    def start(self, task: Task) -> None:
        """Take a task; never waits."""

    def finished(self, timeout: float) -> list[tuple[Task, Outcome]]:
        """What has ended, waiting up to `timeout` seconds for the first."""

    def progress(self) -> dict[tuple[str, str], tuple[str, int, int]]:
        """(row, stage) -> (step, done, total) of what runs, as far as it is known."""

    def stop(self) -> list[tuple[Task, Outcome]]:
        """End all that runs, as after Ctrl-C; what became of it."""


@dataclass
class RowState:
    """What is known of one row, small enough for thousands of them."""

    row: Row
    """As the manifest has it."""
    tasks: tuple[Task, ...]
    """In order, each after those that it needs."""
    states: dict[str, str] = field(default_factory=dict)
    """Stage -> state."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Stage -> wall time of its commands."""
    errors: dict[str, str] = field(default_factory=dict)
    """Stage -> why it failed."""
    notes: dict[str, str] = field(default_factory=dict)
    """Stage -> what a person should know of it though it is done."""
    scores: dict[str, float] = field(default_factory=dict)
    """What the fit measured."""
    quality: str = ""
    """The fit's own word for it: good, usable with limits, poor."""
    size: tuple[int, int, int] | None = None
    """Frames, width and height that are fitted."""
    input: str = ""
    """A picture of the clip."""
    files: dict[str, str] = field(default_factory=dict)
    """What is linked -> file: diagnostics, scene, and of every query, render (all parts in one) and export what shows it best."""
    logs: tuple[str, ...] = ()
    """Stages that left a log."""
    hosts: tuple[str, ...] = ()
    """Machines that worked on it."""
    missing: tuple[str, ...] = ()
    """Paths that it reads and where nothing is."""
    old: tuple[str, ...] = ()
    """Files in the store that earlier runs made and this one does not keep."""

    @property
    def state(self) -> str:
        """Of the row as a whole: failed, done, running, or waiting."""
        states = set(self.states.values())
        if FAILED in states:
            return FAILED
        if states <= {DONE, KEPT}:
            return DONE
        return RUNNING if RUNNING in states else WAITING

    def take(self, outcome: Outcome) -> None:
        """Keep what the index and the table show of an outcome."""
        stage = outcome.stage
        self.seconds[stage] = outcome.seconds
        self.errors.pop(stage, None)
        if outcome.error:
            self.errors[stage] = outcome.error
        if outcome.note:
            self.notes[stage] = outcome.note
        if outcome.host not in self.hosts and outcome.host:
            self.hosts = (*self.hosts, outcome.host)
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
    def picture(self) -> str:
        """The rendered file that stands for the row; empty where none is there."""
        found = [file for what, file in self.files.items() if what.startswith("render") and file.endswith(".png")]
        return max(found, key=self._fitness, default="")

    def _fitness(self, name: str) -> tuple[bool, ...]:
        """How well a file shows the clip: best as it was filmed, in colour, and that moment which `input` shows."""
        path = PurePosixPath(name)
        moment = f"{self.size[0] // 2:05d}" if self.size else ""
        return "original" in path.parts, "rgb" in path.parts, path.suffix == ".png", path.stem == moment


class Board:
    """All rows of a batch, and what is known of them; counts are kept up to date, for a table may ask often."""

    def __init__(self, rows: Sequence[RowState], others: Sequence[RowState] = ()):
        """`rows` in the order of the manifest; `others` lie in the store and are in no row of it."""
        self.rows = {each.row.name: each for each in rows}
        self.others = tuple(others)
        found = {task.kind for each in rows for task in each.tasks}
        self.kinds = tuple(kind for kind in KINDS if kind in found)
        """Kinds of task that occur."""
        self.counts = {
            kind: Counter(each.states[t.stage] for each in rows for t in each.tasks if t.kind == kind)
            for kind in self.kinds
        }
        """Kind -> state -> number of tasks."""
        self.times = {kind: (0.0, 0) for kind in self.kinds}
        """Kind -> (seconds, number) of tasks that came to their end, in earlier runs too."""
        for each in rows:
            for task in each.tasks:
                if each.states[task.stage] == KEPT:
                    self._count_time(task, each.seconds[task.stage])
        self.started, self.slots = time.monotonic(), 1

    def mark(self, task: Task, state: str) -> None:
        """Put a task into another state."""
        states = self.rows[task.row].states
        self.counts[task.kind][states[task.stage]] -= 1
        self.counts[task.kind][state] += 1
        states[task.stage] = state

    def settle(self, task: Task, outcome: Outcome) -> None:
        """Take in what became of a task; what needs a failed one is skipped."""
        each = self.rows[task.row]
        self.mark(task, outcome.state)
        each.take(outcome)
        if outcome.state == DONE:
            self._count_time(task, outcome.seconds)
        else:
            self._skip_after(each, task)

    @property
    def failed(self) -> list[RowState]:
        """Rows that did not come to their end because of a failure."""
        return [each for each in self.rows.values() if each.state == FAILED]

    def number(self, *states: str) -> int:
        """Tasks that are in one of `states`; all where none is named."""
        return sum(
            count for counts in self.counts.values() for state, count in counts.items() if state in (states or counts)
        )

    def eta(self) -> float | None:
        """Seconds until the end, from the mean time of each kind of task so far; None where one has not ended yet."""
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
    """The tasks of all rows, those that are done already marked as kept.

    Reads every clip once to know its content; with `remember` the store keeps what it was.
    """
    known = None
    with contextlib.suppress(ValueError):  # damaged: all clips are read again
        known = json.loads(store.read(DIGESTS) or b"{}")
    digests = Digests(known)

    def state_of(row: Row) -> RowState:
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
            state.take(record)
        return state

    states = []
    with ThreadPoolExecutor(READERS) as pool:
        for done, state in enumerate(pool.map(state_of, rows), 1):
            states.append(state)
            progress(done, len(rows))
    if not remember:
        return Board(states)
    store.write(DIGESTS, json.dumps(digests.to_json()).encode())
    others = [_read_other(store, name) for name in store.folders() if name not in {row.name for row in rows}]
    return Board(states, [each for each in others if each.states])


def _read_other(store: Store, name: str) -> RowState:
    """What records tell of a folder that is no row of the manifest; without states where it has none."""
    each = RowState(Row(name, name), ())
    found = [parse_record(store.read(file)) for file in store.sizes(f"{name}/{STATE}") if _is_record(file)]
    records = [record for record in found if record is not None]
    sizes = store.sizes(name) if records else {}
    order = {kind: number for number, kind in enumerate(KINDS)}
    for record in sorted(records, key=lambda record: order.get(record.stage.split(" ")[0], len(order))):
        each.states[record.stage] = KEPT if record.state == DONE else FAILED
        there = {file: size for file, size in record.files.items() if f"{name}/{file}" in sizes}
        each.take(replace(record, files=there))
    return each


def _is_record(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return len(parts) == 3 and parts[1] == STATE


def _old_files(store: Store, each: RowState, names: Set[str]) -> Iterator[str]:
    """Which of the files `names`, none of a kept task, were made by tasks of the row, or saved by ones not asked for any more.

    A failed task's record stays, to be told, as long as it is asked for.
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
    """Work on everything that waits. One row's failure never stops another.

    `watch(board)` is called about five times a second, `ended(board, outcome)` once for every task, `begins(row)` once for every
    row, before its first task; KeyboardInterrupt ends what runs and goes through.
    """
    board.slots, board.started = engine.slots, time.monotonic()
    order = {name: number for number, name in enumerate(board.rows)}
    ready: list[tuple[int, int, Task]] = []

    def release(each: RowState) -> None:
        """Queue the tasks of a row that wait for nothing any more."""
        for number, task in enumerate(each.tasks):
            if each.states[task.stage] == WAITING and all(
                each.states[stage] in (DONE, KEPT) for stage, _ in task.inputs
            ):
                board.mark(task, READY)
                heapq.heappush(ready, (order[task.row], number, task))

    def settle(outcomes: Sequence[tuple[Task, Outcome]]) -> None:
        for task, outcome in outcomes:
            board.settle(task, outcome)
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
            settle(outcomes)
            for task, _ in outcomes:
                release(board.rows[task.row])
            watch(board)
    except BaseException:
        settle(engine.stop())
        raise


def clear_work(store: Store) -> None:
    """Remove what killed tasks of earlier runs left in a folder; for the holder of the lock."""
    if store.local is not None:
        shutil.rmtree(store.local / STATE / "work", ignore_errors=True)


def clear_old(store: Store, each: RowState) -> None:
    """Remove what earlier runs made in a row and this one does not keep, so that nothing old lies beside what is new.

    That is what records say was made by tasks that are to be done anew or are not asked for any more, and nothing else. Row by
    row, when its work begins: a slip in the command, stopped soon, costs the rows that were at work.
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
    """Hold the one lock of a store; F4xError where another batch holds it."""
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
    """Who holds the lock; None where it is gone or dead."""
    try:
        other = json.loads(data or b"")
        if time.time() - other["beat"] > STALE:
            return None
        if other["host"] == socket.gethostname() and os.name != "nt":
            os.kill(other["pid"], 0)
    except (ValueError, KeyError, ProcessLookupError):
        return None
    except PermissionError:  # somebody else's process, which lives
        pass
    return other
