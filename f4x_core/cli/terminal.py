"""Progress on standard error: one bar per stage on a terminal, a line now and then in a log."""

from __future__ import annotations

import signal
import sys
import threading
import time
from datetime import timedelta
from types import FrameType, TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.table import Column
from rich.text import Text

from ..printing import discard, one_line
from ..processes import LineProgress

# Narrow enough to leave a terminal of 80 columns room for a message.
BAR_WIDTH = 14
# In a log, a running stage gets a line at each tenth of its steps, but not more often than this (seconds).
LOG_EVERY = 10.0


class ErrorConsole(Console):
    """Standard error for lines, bars and tables. Names cannot steer it; what it cannot take is left out, for work goes on."""

    def __init__(self, quiet: bool = False):
        """Print text on standard error as it is: no markup, no highlighting, no wrapping."""
        super().__init__(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a string as rich draws it, be it a line or the cell of a table."""
        return super().render_str(one_line(text), **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, unless standard error is full or closed."""
        try:
            super().print(*objects, **options)
        except OSError:
            discard(sys.stderr)

    def on_broken_pipe(self) -> None:
        """Go on where the reader of standard error has gone; rich would end the process."""
        discard(sys.stderr)


class TerminalProgress:
    """A `Progress` that draws bars, as a context manager. `quiet` draws nothing; `lines` receives every report too.

    Before the first report Ctrl-C stops at once, because there is nothing to save yet. Afterwards it stops at the next report,
    so that the work ends between two steps and saves complete files; pressed a second time, it stops at once. Where the caller
    ignores SIGINT, as `nohup` and shells in the background do, it stays ignored.
    """

    def __init__(self, quiet: bool = False, lines: LineProgress | None = None):
        """Prepare the bars."""
        self.lines = lines
        self.console = ErrorConsole(quiet)
        self.bars = Bars(
            TextColumn("{task.description}", markup=False),
            BarColumn(BAR_WIDTH),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn(
                "{task.fields[message]}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")
            ),
            console=self.console,
            expand=True,
            disable=quiet or not self.console.is_terminal,
        )
        self.tasks: dict[str, TaskID] = {}
        self.logged: dict[str, tuple[int, float]] = {}  # stage -> steps done at its last report, and when it began
        self.last_line_at = 0.0  # monotonic time in seconds
        self.interrupted = False
        self.handler: Any = None

    def __enter__(self) -> TerminalProgress:
        in_main_thread = threading.current_thread() is threading.main_thread()  # no other may set handlers
        if in_main_thread and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
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
        if self.lines is not None:
            self.lines(stage, done, total, message)
        stage, message = one_line(stage), one_line(message)
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=total, message="")
        if not self.console.is_terminal:
            self._log(stage, done, total, message)
            return
        self.bars.start()  # not earlier: bars without a stage would leave an empty line
        task = self.tasks[stage]
        if done == 0 and self.bars.tasks[task].finished:  # once more: its clock starts again
            self.bars.reset(task)
        self.bars.update(task, completed=done, total=total, message=message)

    def _log(self, stage: str, done: int, total: int, message: str) -> None:
        """Print a line when a stage starts or starts again, and when a long one has done another tenth."""
        now, about = time.monotonic(), f" ({message})" if message else ""
        before, began = self.logged.get(stage, (done + 1, now))
        if done < before:
            began = now
            line = f"{stage}{about}"
        elif total and 10 * done // total > 10 * before // total and now - self.last_line_at >= LOG_EVERY:
            line = f"{stage}: {done} of {total} after {timedelta(seconds=int(now - began))}{about}"
        else:
            line = ""
        self.logged[stage] = done, began
        if line:
            self.last_line_at = now
            self.console.print(line)
