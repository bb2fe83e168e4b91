"""What a person sees while waiting: one bar per stage with the time left, on standard error."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars


class TerminalProgress:
    """A `Progress` that draws bars; used as a context manager. `quiet` draws nothing.

    Ctrl-C is answered at the next report, so that the work stops between two steps and what it saves is whole; pressed
    once more it is answered at once.
    """

    def __init__(self, quiet: bool = False):
        """Prepare the bars."""
        self.bars = Bars(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[message]}"),
            console=Console(stderr=True),
            disable=quiet,
        )
        self.tasks: dict[str, TaskID] = {}
        self.interrupted = False
        self.handler: Any = None

    def __enter__(self) -> TerminalProgress:
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            self.handler = signal.signal(signal.SIGINT, self._interrupt)
        self.bars.start()
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.bars.stop()
        if self.handler is not None:
            signal.signal(signal.SIGINT, self.handler)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    def __call__(self, stage: str, done: int, total: int, message: str = "") -> None:
        """Draw the state of one stage; raises KeyboardInterrupt after Ctrl-C."""
        if self.interrupted:
            raise KeyboardInterrupt
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=total, message=message)
        self.bars.update(self.tasks[stage], completed=done, total=total, message=message)
