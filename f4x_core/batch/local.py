"""An engine that runs tasks in child processes on this machine."""

from __future__ import annotations

import queue
import threading
from functools import partial

from .graph import Task
from .work import Outcome, Settings, run_task


class LocalEngine:
    """An `Engine` with up to `slots` threads, each of which waits for the child process of one task."""

    def __init__(self, settings: Settings, slots: int):
        """Prepare without starting anything."""
        self.settings, self.slots = settings, slots
        self.ended: queue.SimpleQueue[tuple[Task, Outcome]] = queue.SimpleQueue()
        self.running: dict[tuple[str, str], threading.Thread] = {}
        self.steps: dict[tuple[str, str], tuple[str, int, int]] = {}
        self.stopping = threading.Event()

    def start(self, task: Task) -> None:
        """See `Engine.start`."""
        thread = threading.Thread(target=self._work, args=(task,), daemon=True)
        self.running[task.row, task.stage] = thread
        thread.start()

    def finished(self, timeout: float) -> list[tuple[Task, Outcome]]:
        """See `Engine.finished`."""
        found: list[tuple[Task, Outcome]] = []
        while True:
            try:
                found.append(self.ended.get(timeout=0 if found else timeout))
            except queue.Empty:
                break
        for task, _ in found:
            self.running.pop((task.row, task.stage)).join()
            self.steps.pop((task.row, task.stage), None)
        return found

    def progress(self) -> dict[tuple[str, str], tuple[str, int, int]]:
        """See `Engine.progress`."""
        return dict(self.steps)

    def stop(self) -> list[tuple[Task, Outcome]]:
        """See `Engine.stop`."""
        self.stopping.set()
        for thread in self.running.values():
            thread.join()
        return self.finished(0)

    def _work(self, task: Task) -> None:
        progress = partial(self._report, (task.row, task.stage))
        outcome = Outcome(task.row, task.stage, task.key, "failed", "the batch itself failed; see the message above.")
        try:
            outcome = run_task(task, self.settings, progress, self.stopping.is_set)
        finally:  # whatever happened, the other rows go on
            self.ended.put((task, outcome))

    def _report(self, task: tuple[str, str], stage: str, done: int, total: int, message: str = "") -> None:
        self.steps[task] = (stage, done, total)
