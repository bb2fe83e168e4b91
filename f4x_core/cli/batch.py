"""`f4x batch`."""

from __future__ import annotations

import argparse
import io
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rich.live import Live
from rich.table import Table

from ..batch.checks import require_values
from ..batch.graph import CLIP, declared_frames
from ..batch.index import write_index
from ..batch.local import LocalEngine
from ..batch.manifest import PAGE, Row, read_manifest
from ..batch.run import (
    DONE,
    FAILED,
    KEPT,
    READY,
    RUNNING,
    SKIPPED,
    STOPPED,
    WAITING,
    Board,
    Engine,
    RowState,
    clear_old,
    clear_work,
    locked,
    plan,
    run_board,
)
from ..batch.storage import URL, Store, open_store
from ..batch.work import Outcome, Settings
from ..errors import F4xError
from ..progress import Progress
from .checks import require_folder, why_slow
from .fitting import config_of
from .terminal import ErrorConsole

MAX_EXIT_CODE = 100
"""The exit code is the number of failed rows, at most this: shells give higher codes other meanings."""
INDEX_EVERY = 5.0
"""Minimum seconds between two updates of the index."""
INDEX_PAUSE_FACTOR = 20
"""The pause between two updates is at least this many times as long as an update takes."""
MARKS = {WAITING: "·", READY: "·", RUNNING: "…", DONE: "✓", KEPT: "✓", FAILED: "✗", SKIPPED: "–", STOPPED: "‖"}
ENDED = (DONE, KEPT, FAILED, SKIPPED)
"""States of a task that has ended."""
SHOWN_ROWS = 20
"""Maximum number of rows in the table: running ones and those that failed last."""


def run_batch(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Run all tasks of a manifest except those that are already done."""
    if URL not in args.place:
        require_folder(Path(args.place))
    if args.jobs is not None and args.jobs < 1:
        raise F4xError(f"--jobs {args.jobs}: give 1 or more.")
    rows = read_manifest(args.manifest, _defaults(args.set))
    store = open_store(args.place)
    with Screen(args, progress) as screen:
        if any(row.backend == "auto" for row in rows) and (slow := why_slow()):
            screen.console.print(slow)
        if args.dry_run:
            board = plan(rows, store, screen.read)
            _require_commands(board)
            return _plan_result(board)
        with locked(store):
            board = plan(rows, store, screen.read, remember=True)
            _require_commands(board)
            settings = Settings(store.url, args.scratch)
            start = time.monotonic()
            try:
                with _engine(args, settings, board) as engine:
                    clear_work(store)
                    run_board(board, engine, screen.watch(engine, store), screen.tell, partial(clear_old, store))
            finally:
                write_index(store, board, args.manifest)
    return _batch_result(board, store, time.monotonic() - start)


def _defaults(entries: list[str]) -> dict[str, str]:
    defaults = {}
    for entry in entries:
        name, equals, value = entry.partition("=")
        if not (name and equals):
            raise F4xError(f"--set {entry}: write COLUMN=VALUE, for example profile=quick.")
        defaults[name] = value
    return defaults


def _require_commands(board: Board) -> None:
    """Raise F4xError before the first task if `f4x` would refuse an argument of any command."""
    from .parser import build_parser

    parser = build_parser()
    for each in board.rows.values():
        try:
            require_values(each.row)
        except F4xError as error:
            raise F4xError(f"row {each.row.name}: {error}") from error
        for task in each.tasks:
            for command in task.commands:
                try:
                    args = parser.parse_args([each.row.clip if word == CLIP else word for word in command])
                    if task.kind == "fit":
                        config_of(args)
                except F4xError as error:
                    raise F4xError(f"row {each.row.name}, {task.stage}: {error}") from error


@contextmanager
def _engine(args: argparse.Namespace, settings: Settings, board: Board) -> Iterator[Engine]:
    open_tasks = [task for each in board.rows.values() for task in each.tasks if each.states[task.stage] == WAITING]
    if args.ray is None or not open_tasks:  # without tasks there is no reason to wait for a cluster
        threads = max(each.row.threads for each in board.rows.values())
        yield LocalEngine(settings, args.jobs or max(1, (os.cpu_count() or 1) // threads))
        return
    from ..batch.ray_engine import RayEngine

    # When a worker dies, Ray prints messages on standard output, which programs read; the task's record has the reason.
    with RayEngine(settings, args.ray, open_tasks) as engine, redirect_stdout(io.StringIO()):
        yield engine


class Screen:
    """Shows a running batch: a table on a terminal, a line per finished task in a log, JSON lines for programs.

    A context manager.
    """

    def __init__(self, args: argparse.Namespace, progress: Progress):
        """Prepare without drawing anything."""
        self.title, self.progress = args.manifest, progress
        self.for_programs = args.progress_json or args.json
        self.console = ErrorConsole(quiet=self.for_programs)
        drawn = self.console.is_terminal and not self.for_programs
        self.live = Live(console=self.console, auto_refresh=False, transient=True) if drawn else None

    def __enter__(self) -> Screen:
        if self.live is not None:
            self.live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.live is not None:
            self.live.stop()

    def read(self, done: int, total: int) -> None:
        """Show how many clips have been read."""
        if self.for_programs:
            self.progress("reading clips", done, total)
        elif self.live is not None:
            self.live.update(f"reading clips {done}/{total}", refresh=True)
        elif done == 1:
            self._log("reading clips")

    def tell(self, board: Board, outcome: Outcome) -> None:
        """Log the outcome of a task."""
        if self.live is not None:
            return
        message = outcome.error or outcome.note
        ended = f"{board.number(*ENDED)} of {board.number()}{_time_left(board)}"
        line = f"{outcome.row}, {outcome.stage}: {outcome.state} in {outcome.seconds:.0f} s, {ended}"
        self._log(f"{line}: {message}" if message else line)

    def _log(self, line: str) -> None:
        self.console.print(f"{datetime.now():%H:%M:%S} {line}")

    def watch(self, engine: Engine, store: Store) -> Callable[[Board], None]:
        """Return a function that shows the board's current state and updates the index from time to time."""
        next_index = time.monotonic() + INDEX_EVERY

        def watch(board: Board) -> None:
            nonlocal next_index
            if self.for_programs:
                self.progress("batch", board.number(*ENDED), board.number(), _time_left(board))
            elif self.live is not None:
                self.live.update(status_table(board, engine), refresh=True)
            if time.monotonic() >= next_index:
                start = time.monotonic()
                write_index(store, board, self.title)
                took = time.monotonic() - start
                next_index = time.monotonic() + max(INDEX_EVERY, INDEX_PAUSE_FACTOR * took)

        return watch


def status_table(board: Board, engine: Engine) -> Table:
    """Return a table of the running and the last failed rows, a column for each kind of task, and total counts in the footer."""
    table = Table(box=None, pad_edge=False, show_footer=True)
    rows = list(board.rows.values())
    done = sum(each.state == DONE for each in rows)
    failed = len(board.failed)
    footer = f"{done} of {len(rows)} clips" + (f", {failed} failed" if failed else "") + _time_left(board)
    table.add_column("clip", footer=footer, no_wrap=True)
    for kind in board.kinds:
        counts = board.counts[kind]
        table.add_column(kind, footer=f"{counts[DONE] + counts[KEPT]}/{counts.total()}", justify="right")
    steps = engine.progress()
    at_work = [each for each in rows if RUNNING in each.states.values()]
    for each in [*board.failed[-SHOWN_ROWS // 4 :], *at_work][:SHOWN_ROWS]:
        table.add_row(each.row.name, *(_cell(each, kind, steps) for kind in board.kinds))
    return table


def _cell(each: RowState, kind: str, steps: dict[tuple[str, str], tuple[str, int, int]]) -> str:
    stages = [task.stage for task in each.tasks if task.kind == kind]
    for stage in stages:
        name, done, total = steps.get((each.row.name, stage), ("", 0, 0))
        if each.states[stage] == RUNNING and total:
            return f"{name} {done / total:.0%}"
    states = [each.states[stage] for stage in stages]
    if len(states) > 1 and set(states) - {DONE, KEPT}:
        return f"{sum(state in (DONE, KEPT) for state in states)}/{len(states)}"
    return MARKS[states[0]] if states else ""


def _time_left(board: Board) -> str:
    seconds = board.eta()
    return "" if not seconds else f", about {_duration(seconds)} left"


def _duration(seconds: float) -> str:
    for unit, name in ((86400, "days"), (3600, "hours"), (60, "minutes")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} seconds"


def _plan_result(board: Board) -> dict[str, Any]:
    """Return the result of a dry run: all tasks with their states."""
    rows = [_row_plan(each) for each in board.rows.values()]
    lines = [
        f"{row['name']}: " + ", ".join(f"{task['stage']} [{task['state']}]" for task in row["tasks"]) for row in rows
    ]
    lines += [f"{row['name']}: {path} is missing" for row in rows for path in row["missing"]]
    lines += [f"{row['name']}: {row['fault']}" for row in rows if row["fault"]]
    to_do, left = board.number(WAITING), _time_left(board)
    lines.append(f"{to_do} of {board.number()} tasks to do{left and f'{left}, one at a time'}; nothing was done")
    return {
        "rows": rows,
        "tasks": board.number(),
        "to_do": to_do,
        "seconds_left": board.eta(),
        "text": "\n".join(lines),
        "exit_code": _exit_code([row for row in rows if row["missing"] or row["fault"]]),
    }


def _row_plan(each: RowState) -> dict[str, Any]:
    row: Row = each.row
    states = each.states | dict.fromkeys(each.errors, FAILED)  # of earlier runs: they will be tried again
    tasks = [{"stage": t.stage, "state": states[t.stage], "commands": t.commands} for t in each.tasks]
    found = {"missing": list(each.missing), "fault": declared_frames(row)[1]}
    return {"name": row.name, "clip": row.clip, **found, "errors": each.errors, "tasks": tasks}


def _exit_code(failed: Sequence[Any]) -> int:
    return min(len(failed), MAX_EXIT_CODE)


def _batch_result(board: Board, store: Store, seconds: float) -> dict[str, Any]:
    """Return the result of the verb: counts, errors and notes of all rows."""
    rows = list(board.rows.values())
    failed = {each.row.name: each.errors for each in board.failed}
    index = f"{store.url}/{PAGE}"
    done, kept, new = sum(each.state == DONE for each in rows), board.number(KEPT), board.number(DONE)
    notes = {each.row.name: each.notes for each in rows if each.notes}
    messages = [*notes.items(), *failed.items()]
    lines = [f"{name}, {stage}: {text}" for name, by_stage in messages for stage, text in by_stage.items()]
    lines.append(
        f"{done} of {len(rows)} clips are done, {len(failed)} failed; {new} tasks in {_duration(seconds)}, {kept} were done before"
    )
    return {
        "rows": len(rows),
        "done": done,
        "failed": failed,
        "notes": notes,
        "tasks": {"done": new, "kept": kept, "failed": board.number(FAILED), "skipped": board.number(SKIPPED)},
        "seconds": seconds,
        "index": index,
        "text": "\n".join([*lines, index]),
        "exit_code": _exit_code(board.failed),
    }
