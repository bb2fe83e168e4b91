"""What a person sees while waiting: one bar per stage with the time left, on standard error."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars


class TerminalProgress:
    """A `Progress` that draws bars; used as a context manager. `quiet` draws nothing."""

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

    def __enter__(self) -> TerminalProgress:
        self.bars.start()
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.bars.stop()

    def __call__(self, stage: str, done: int, total: int, message: str = "") -> None:
        """Draw the state of one stage."""
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=total, message=message)
        self.bars.update(self.tasks[stage], completed=done, total=total, message=message)
