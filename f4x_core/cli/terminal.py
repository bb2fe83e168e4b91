"""What a person sees while waiting, on standard error: one bar per stage; in a log, lines now and then."""

from __future__ import annotations

import signal
import threading
import time
from datetime import timedelta
from types import FrameType, TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.table import Column

from ..processes import LineProgress

# Narrow enough to leave a terminal of 80 columns room for a message.
BAR_WIDTH = 14
# In a log a stage that goes on is told of at each tenth, but not more often than this (seconds).
LOG_EVERY = 10.0


class TerminalProgress:
    """A `Progress` that draws bars; used as a context manager. `quiet` draws nothing; `lines` is told too.

    Ctrl-C is answered at once before the first report, when there is nothing to save yet. Afterwards it is answered at the
    next report, so that the work stops between two steps and what it saves is whole; pressed once more, at once.
    """

    def __init__(self, quiet: bool = False, lines: LineProgress | None = None):
        """Prepare the bars."""
        self.lines = lines
        self.console = Console(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)
        self.bars = Bars(
            TextColumn("{task.description}", markup=False),
            BarColumn(BAR_WIDTH),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn(
                "{task.fields[message]}",
                markup=False,
                table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
            ),
            console=self.console,
            expand=True,
            disable=quiet or not self.console.is_terminal,
        )
        self.tasks: dict[str, TaskID] = {}
        self.logged: dict[str, tuple[int, float]] = {}  # stage -> steps done at its last report, and when it began
        self.told = 0.0  # when the last line was printed
        self.interrupted = False
        self.handler: Any = None

    def __enter__(self) -> TerminalProgress:
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            self.handler = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:  # a stage that ended early, having reached its limit, is complete too
            for task in self.bars.tasks:
                self.bars.update(task.id, completed=task.total)
        self.bars.stop()
        if self.handler is not None:
            signal.signal(signal.SIGINT, self.handler)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted or not self.tasks:
            raise KeyboardInterrupt
        self.interrupted = True
        self.console.print("Stopping after this step; press Ctrl-C again to stop at once.")

    def __call__(self, stage: str, done: int, total: int, message: str = "") -> None:
        """Draw the state of one stage; raises KeyboardInterrupt after Ctrl-C."""
        if self.interrupted:
            raise KeyboardInterrupt
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=total, message="")
        if self.lines is not None:
            self.lines(stage, done, total, message)
        if not self.console.is_terminal:
            self._log(stage, done, total, message)
            return
        self.bars.start()  # not earlier: bars without a stage would leave an empty line
        task = self.tasks[stage]
        if done == 0 and self.bars.tasks[task].finished:  # once more: its clock starts again
            self.bars.reset(task)
        self.bars.update(task, completed=done, total=total, message=message)

    def _log(self, stage: str, done: int, total: int, message: str) -> None:
        """Print a line where a stage begins, also anew, and where a long one has come a tenth further."""
        now, about = time.monotonic(), f" ({message})" if message else ""
        before, began = self.logged.get(stage, (done + 1, now))
        if done < before:
            began = now
            line = f"{stage}{about}"
        elif total and 10 * done // total > 10 * before // total and now - self.told >= LOG_EVERY:
            line = f"{stage}: {done} of {total} after {timedelta(seconds=int(now - began))}{about}"
        else:
            line = ""
        self.logged[stage] = done, began
        if line:
            self.told = now
            self.console.print(line)
