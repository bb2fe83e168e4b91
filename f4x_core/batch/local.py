"""Tasks in processes of this machine, so many at a time."""

from __future__ import annotations

import queue
import threading
from functools import partial

from .graph import Task
from .work import Outcome, Settings, run_task


class LocalEngine:
    """An `Engine` of `slots` threads, each of which waits for the child that works on its task."""

    def __init__(self, settings: Settings, slots: int):
        """Nothing runs yet."""
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
        tell = partial(self._tell, (task.row, task.stage))
        outcome = Outcome(task.row, task.stage, task.key, "failed", "the batch itself failed; see the message above.")
        try:
            outcome = run_task(task, self.settings, tell, self.stopping.is_set)
        finally:  # whatever happened, the other rows go on
            self.ended.put((task, outcome))

    def _tell(self, of: tuple[str, str], stage: str, done: int, total: int, message: str = "") -> None:
        self.steps[of] = (stage, done, total)
