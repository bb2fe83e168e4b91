"""A job: a verb of the core in its own Python process, polled now and then. Nothing here uses Blender or blocks.

job = Job("Fit dog.mp4", core_command(python, "fit", "dog.mp4", "-o", "dog"))
while job.poll(): ...          # a timer's tick
job.state, job.result, job.error, job.log
"""

import contextlib
import json
import queue
import shutil
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any, TextIO

from ...f4x_core.errors import F4xError
from ...f4x_core.processes import GRACE, end_tree, start_child
from ...f4x_core.troubles import EXPECTED, UNKNOWN, code_of_module, coded, with_code

ROOT = Path(__file__).resolve().parents[2]
"""The extension: a child that starts here finds the extension's own `f4x_core`, whatever its interpreter has installed."""
PATIENCE = 60.0
"""Maximum seconds until the first line of the protocol; a slow disk needs many. A process without a line is no worker."""
MARGIN = 0.4
"""Seconds beyond GRACE after which a cancelled child that still runs is killed."""
LOG_LINES = 200
"""Lines of the log that are kept."""
MAX_BUFFERED_LINES = 1000
"""Lines that are buffered between two polls; then the child waits."""
MAX_LINE_CHARACTERS = 1 << 24
"""Characters; a longer line is read in pieces."""

_numbers = count()

RUNNING, DONE, FAILED, CANCELLED = "running", "done", "failed", "cancelled"


def core_command(interpreter: Path | str, verb: str, *arguments: Path | str) -> list[str]:
    """Return the command line of one verb of `f4x` that reports in JSON lines."""
    return [str(interpreter), "-m", "f4x_core", verb, *map(str, arguments), "--progress-json"]


def own_command(module: str, *arguments: Path | str, interpreter: str | None = None) -> list[str]:
    """Return the command line that runs a module of the core; without `interpreter` Blender's own Python does, on numpy alone."""
    return [interpreter or sys.executable, "-m", f"f4x_core.{module}", *map(str, arguments)]


class Job:
    """One child process; `poll` never blocks."""

    def __init__(
        self,
        title: str,
        command: Sequence[str],
        on_done: Callable[[dict[str, Any]], None] | None = None,
        patience: float = PATIENCE,
    ):
        """Start `command`; `on_done(result)` is called by the `poll` after the one that finds it succeeded.

        Raises:
            F4xError: the interpreter does not exist or cannot be started.
        """
        self.title, self.on_done, self.number = title, on_done, next(_numbers)
        self.state, self.error, self.text = RUNNING, "", ""
        self.instead = ""  # what was probably meant, where the child asks
        self.result: dict[str, Any] | None = None
        self.stage, self.done, self.total, self.message = "starting", 0, 0, ""
        self.arrived = False
        """True once the result is there: the next `poll` calls `on_done`, and the window says so before that keeps it busy."""
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self.interpreter = command[0]
        if shutil.which(self.interpreter) is None:
            raise F4xError(
                f"{self.interpreter} is missing or cannot be run; choose the worker's Python, or press Set Up."
            )
        try:
            self.child = start_child(command, ROOT)
        except OSError as error:
            reason = error.strerror or str(error)
            raise F4xError(f"{self.interpreter} cannot be run ({reason}); choose the worker's Python.") from error
        self._started, self._patience, self._answered = time.monotonic(), patience, False
        self._deadline: float | None = None  # of a cancelled child
        self._gone_at = 0.0
        self._lines: queue.Queue[tuple[bool, str] | None] = queue.Queue(MAX_BUFFERED_LINES)
        self._open = 2  # streams that have not ended
        for protocol, stream in ((True, self.child.stdout), (False, self.child.stderr)):
            threading.Thread(target=self._read, args=(protocol, stream), daemon=True).start()

    @property
    def fraction(self) -> float:
        """Progress of the stage from 0 to 1; 0 if unknown."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    def _read(self, protocol: bool, stream: TextIO) -> None:
        while line := stream.readline(MAX_LINE_CHARACTERS):
            self._lines.put((protocol, line))
        self._lines.put(None)

    def poll(self) -> bool:
        """Read the lines that the child has printed; returns True while it runs."""
        if self.state != RUNNING:
            return False
        for _ in range(MAX_BUFFERED_LINES):
            try:
                entry = self._lines.get_nowait()
            except queue.Empty:
                break
            if entry is None:
                self._open -= 1
            else:
                self._handle_line(*entry)
        now = time.monotonic()
        if self._deadline is not None:
            if self.child.poll() is not None or now > self._deadline:
                self._end(CANCELLED)
        elif not self._answered and now - self._started > self._patience:
            self._end(
                FAILED, f"{self.interpreter} did not answer within {self._patience:.0f} s; choose another Python."
            )
        elif self.child.poll() is not None:
            self._gone_at = self._gone_at or now
            # a process that the ended child left behind may hold its streams open for ever
            if not self._open or (self._lines.empty() and now - self._gone_at > MARGIN):
                self._finish(self.child.returncode)
        return self.state == RUNNING

    def cancel(self) -> None:
        """Ask the child to stop, without waiting: it saves its work and ends within 2 s, with all its own child processes."""
        if self.state == RUNNING and self._deadline is None:
            self._deadline = time.monotonic() + GRACE + MARGIN
            self.message = "stopping"
            with contextlib.suppress(OSError):  # it is gone already
                self.child.stdin.close()

    def kill(self) -> None:
        """Kill the child and all its own child processes at once."""
        if self.state == RUNNING:
            self._end(CANCELLED)

    def wait(self, look: Callable[["Job"], None] = lambda job: None, glance: float = 0.05) -> None:
        """Block until the job ends, calling `look` regularly: Blender without a window has no timers."""
        while self.poll():
            look(self)
            time.sleep(glance)

    def _handle_line(self, protocol: bool, line: str) -> None:
        message = _object(line) if protocol else None
        if message is None:
            if line.strip():
                self.log.append(line.rstrip())
            return
        self._answered = True
        if "result" in message:
            self.result, self.text = message["result"], str(message.get("text") or "")
            self.log.extend(self.text.splitlines())
        elif "error" in message:
            self.error, self.instead = str(message["error"]), str(message.get("instead") or "")
        elif "stage" in message:
            self.stage, self.message = str(message["stage"]), str(message.get("message", ""))
            self.done, self.total = _count(message.get("done")), _count(message.get("total"))

    def _finish(self, code: int) -> None:
        if code != 0 or not isinstance(self.result, dict):
            self._end(FAILED, self.error or self._reason(code))
            return
        if self.on_done is not None and not self.arrived:
            self.arrived = True
            return
        self._end(DONE)
        if self.on_done is not None:
            try:
                self.on_done(self.result)
            except Exception as error:  # whatever it is, it must not end the timer that polls all other jobs
                self._fail_to_show(error)

    def _fail_to_show(self, error: Exception) -> None:
        """Fail because of an error of `on_done`; one that no input can cause goes into the log and onto the terminal, too."""
        self.state = FAILED
        if isinstance(error, EXPECTED):
            self.error = with_code(error)
            return
        lines = traceback.format_exception(error)
        print("".join(lines), end="", file=sys.stderr, flush=True)
        self.log.extend("".join(lines).splitlines())
        reason = f"{type(error).__name__}: {error}"
        self.error = coded(f"The task is done, but its result cannot be shown ({reason}); its log says more.", UNKNOWN)

    def _reason(self, code: int) -> str:
        """Return a sentence for a child that ended without one."""
        last_line = self.log[-1] if self.log else "it printed nothing"
        if last_line.startswith("ModuleNotFoundError"):
            package = last_line.rpartition("named ")[2]
            return f"{self.interpreter} has no package {package}; press Set Up, or choose another Python."
        if not self._answered:
            return f"{self.interpreter} is no Python that can run Feature4X ({last_line}); choose another Python, or press Set Up."
        return f"The worker ended with code {code}: {last_line}"

    def _end(self, state: str, error: str = "") -> None:
        self.state, self.error = state, coded(error, code_of_module(__name__)) if error else ""
        if sys.platform != "win32" or self.child.poll() is None:
            end_tree(self.child.pid)  # also what an ended child left behind in its group
        with contextlib.suppress(OSError):
            self.child.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.child.wait(MARGIN)


def _object(line: str) -> dict[str, Any] | None:
    """Return the JSON object on a line of the protocol; None for other lines, which libraries print."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and message.keys() & {"stage", "result", "error"} else None


def _count(value: Any) -> int:
    return int(value) if isinstance(value, (int, float)) and abs(value) < 1e15 else 0
