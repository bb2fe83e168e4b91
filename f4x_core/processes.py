"""Work in a child process for another program: JSON lines from the child, and an end of all of it when that is asked.

Standard library alone: Blender's own Python starts such children, and a bare Python runs `installation` as one.

The child writes one JSON object per line on standard output: `{"stage", "done", "total", "message", "cpu_seconds"}` while it
works, and last `{"result", "text"}` or `{"error"}`, with `instead` where it asks what was meant. Its standard input stays open
as long as somebody waits: when it closes, because the other program wants an end or is itself gone, the child stops as after
Ctrl-C, and GRACE seconds later at the latest it is gone with every process that it started.
"""

import _thread
import atexit
import contextlib
import json
import os
import queue
import signal
import stat
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from .errors import Cancelled, F4xError
from .files import json_text
from .printing import write
from .progress import Progress, silent
from .troubles import EXPECTED, with_code

EXIT_INTERRUPTED = 130
START = "start"
"""Stage that a verb reports before it has done anything: a child that says so lives."""
GRACE = 1.0
"""Seconds that an interrupted child has for its last step and for saving what it has."""
TAIL = 5
"""Lines of a failed child's standard error that its message quotes."""
TICK = 0.2
"""Seconds between two looks at whether somebody wants an end."""
INTERVAL = 0.05
"""Seconds between two lines of one stage: no reader looks more often."""


class LineProgress:
    """A `Progress` that writes JSON lines to `file`; what comes faster than INTERVAL within a stage is left out."""

    def __init__(self, file: TextIO):
        """Begin before the first report, with which the first line is written."""
        self.file = file
        self.stage, self.shown_at = "", 0.0

    def __call__(self, stage: str, done: int, total: int, message: str = "") -> None:
        """Write one report."""
        now = time.monotonic()
        if stage == self.stage and now - self.shown_at < INTERVAL and (done < total or not total):
            return
        self.stage, self.shown_at = stage, now
        used = round(sum(os.times()[:4]), 2)  # its own and its children's: who ends it by force could not ask any more
        self.tell(stage=stage, done=done, total=total, message=message, cpu_seconds=used)

    def tell(self, **line: Any) -> None:
        """Write one line; raises Cancelled when nobody reads any more, OSError when there is no room for it."""
        try:
            write(self.file, json_text(line))
        except BrokenPipeError as error:
            raise Cancelled from error


def serve(work: Callable[[LineProgress], tuple[dict[str, Any], str]]) -> int:
    """Do `work(progress)` for a parent that reads JSON lines, and return the exit code.

    `work` returns the result and a sentence about it. An expected error is reported as `error`; the parent's end ends the work.
    """
    progress = LineProgress(sys.stdout)
    stop_with_parent()
    try:
        result, text = work(progress)
    except (KeyboardInterrupt, Cancelled):
        return EXIT_INTERRUPTED
    except EXPECTED as error:
        instead = getattr(error, "instead", "")
        progress.tell(error=with_code(error), **({"instead": instead} if instead else {}))
        return 2
    progress.tell(result=result, text=text)
    return 0


def stop_with_parent() -> None:
    """Stop this process when its standard input closes; one that is no pipe (a terminal, a file) is left alone.

    Call it in the main thread. A SIGINT that `nohup` or a shell's background ignores is heard again: it is how `_watch` stops
    the main thread, and no terminal sends one to a process that leads a session of its own.
    """
    if sys.stdin is not None and stat.S_ISFIFO(os.fstat(0).st_mode):
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Thread(target=_watch, daemon=True).start()


def _watch() -> None:
    while os.read(0, 4096):
        pass
    atexit.register(end_tree, os.getpid())  # what it started goes with it, also when it ends by itself
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:  # a real signal also wakes a main thread that sleeps or waits for a process
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    time.sleep(GRACE)
    end_tree(os.getpid())
    os._exit(EXIT_INTERRUPTED)  # a process that leads no group of its own


def start_child(
    command: Sequence[str], folder: Path, variables: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    """Start `command` in `folder`, leading a group of its own, with pipes for its three streams.

    Nothing of this process's Python (PYTHONPATH, PYTHONHOME, …) reaches the child's; `variables` of its environment are added
    to the rest. OSError as of Popen.
    """
    group: dict[str, Any] = {"start_new_session": True}
    if sys.platform == "win32":
        group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    pipe = subprocess.PIPE
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "__PYVENV"))}
    return subprocess.Popen(
        list(command),
        cwd=folder,
        env=environment | {"PYTHONUTF8": "1"} | dict(variables or {}),
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        encoding="utf-8",
        errors="replace",
        **group,
    )


@dataclass(frozen=True)
class Ended:
    """End of a child of `run_child`."""

    code: int
    """Exit code; negative: the signal that ended it."""
    last: dict[str, Any]
    """Its last JSON line."""
    tail: str
    """Last lines of its standard error."""
    cpu_seconds: float
    """Of all its cores."""
    memory: int
    """Most bytes that it held at once; 0 where the system does not tell."""

    def result(self) -> dict[str, Any]:
        """Return the child's result.

        Raises:
            F4xError: its own sentence, or how it ended without one.
            Cancelled: it was stopped.
        """
        if "result" in self.last:
            return self.last["result"]
        if self.code == EXIT_INTERRUPTED:
            raise Cancelled
        raise F4xError(self.last.get("error") or self._reason())

    def _reason(self) -> str:
        if self.code < 0:
            return (
                f"it was ended by signal {-self.code} while it held {self.memory / 1e9:.1f} GB; the usual reason is too little"
                " memory: use a smaller width, or fewer tasks at a time."
            )
        return f"it ended with {self.code}: {self.tail.splitlines()[-1] if self.tail else 'no message'}"


def run_child(
    command: Sequence[str],
    folder: Path,
    progress: Progress = silent,
    *,
    tick: Callable[[float], None] | None = None,
    log: TextIO | None = None,
    variables: Mapping[str, str] | None = None,
) -> Ended:
    """Run a child that speaks the protocol above until it ends by itself.

    `tick` is called at least every TICK seconds with the CPU seconds that the child reported last, even while it is silent; `log`
    gets what it writes on standard error. What `progress` or `tick` raises, Cancelled for one, goes through once the child is gone.
    """
    child = start_child(command, folder, variables)
    pipes = _Pipes(child, log)
    last: dict[str, Any] = {}
    line: str | None = ""
    used = 0.0
    try:
        while line is not None:
            try:
                line = pipes.lines.get(timeout=TICK)
            except queue.Empty:
                line = ""
            message = _json_line(line or "")
            if "stage" in message:
                progress(message["stage"], message["done"], message["total"], message["message"])
                used = message["cpu_seconds"]
            last = message or last
            if tick is not None:
                tick(used)
        cpu_seconds, memory = _wait(child)
    except BaseException:
        assert child.stdin is not None
        child.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(2 * GRACE)
        end_tree(child.pid)
        pipes.join(GRACE)  # its last words belong into `log`, which the caller closes
        raise
    end_tree(child.pid)  # one that was killed may have left children
    pipes.join()
    return Ended(child.returncode, last, "".join(pipes.tail).strip(), cpu_seconds or used, memory)


class _Pipes:
    """Threads that read what a child writes: a full pipe would stop it."""

    def __init__(self, child: subprocess.Popen[str], log: TextIO | None):
        """Begin to read; standard error goes to `log`, too."""
        assert child.stdout is not None and child.stderr is not None
        self.lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        """Of standard output; None ends them."""
        self.tail: deque[str] = deque(maxlen=TAIL)
        """Last lines of standard error."""
        works = ((self._listen, (child.stdout,)), (self._keep, (child.stderr, log)))
        self._threads = [threading.Thread(target=work, args=arguments, daemon=True) for work, arguments in works]
        for thread in self._threads:
            thread.start()

    def join(self, patience: float | None = None) -> None:
        """Wait until the child has closed its pipes, `patience` seconds at most for each."""
        for thread in self._threads:
            thread.join(patience)

    def _listen(self, file: TextIO) -> None:
        for line in file:
            self.lines.put(line)
        self.lines.put(None)

    def _keep(self, file: TextIO, log: TextIO | None) -> None:
        for line in file:
            self.tail.append(line)
            if log is not None:
                log.write(line)


def run_verb(arguments: Sequence[str], folder: Path, progress: Progress = silent) -> dict[str, Any]:
    """Run `f4x` with `arguments` in a child of its own, in `folder`; returns the verb's result.

    Raises:
        F4xError: the verb's own sentence, or that it ended without one.
        Cancelled: raised by `progress`, or the child was stopped; it is gone then.
    """
    return run_child([sys.executable, "-m", f"{__package__}", *arguments, "--progress-json"], folder, progress).result()


def _json_line(line: str) -> dict[str, Any]:
    """Return the object on a line; empty for whatever else a library may print."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _wait(child: subprocess.Popen[str]) -> tuple[float, int]:
    """Wait for the end of `child`; its CPU seconds and most bytes of memory."""
    if sys.platform == "win32":
        child.wait()
        return 0.0, 0
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    unit = 1 if sys.platform == "darwin" else 1024
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit


def end_tree(process: int) -> None:
    """End the child `process` of `start_child` and all that it started, at once; nothing where they are gone."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/F", "/T", "/PID", str(process)], capture_output=True, check=False)
    else:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process, signal.SIGKILL)
