"""Running one task: fetch its inputs, run its commands in a child process, publish what they left, and record that it is done.

A row's folder holds the ordinary files of its commands, `logs/STAGE.log`, and below `.batch/` a record for each task. A record is
written last, so that a task is done completely or not at all. While a long task runs, the files from which it can resume are
kept in `.batch/STAGE/`: another attempt, on this machine or another, starts from them.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TextIO

from ..errors import Cancelled, F4xError
from ..printing import one_line
from ..processes import run_child
from ..progress import Progress, silent
from ..reading import parse_json
from .graph import CLIP, Task, slug
from .storage import URL, Store, fetch_tree, open_store

STATE = ".batch"
"""Folder for files of the batch itself, in the batch and in each row."""
SAVE_EVERY = 5.0
"""Seconds between two searches for files from which a later attempt could resume."""
ROOT = Path(__file__).resolve().parents[2]
"""Folder of the package, so that a child process runs the same code whether it is installed or not."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Environment variables that limit libraries to the cores of the task; without them they use all cores."""


@dataclass(frozen=True)
class Settings:
    """Settings for running tasks, equal for all tasks of a batch."""

    url: str
    """Address of the store."""
    scratch: str | None = None
    """Folder for work in progress on the machine that runs the task; None: in a local store, or the machine's temporary folder."""
    program: tuple[str, ...] | None = None
    """Program that runs a command; None: the `f4x` of the machine that runs the task."""
    save_every: float = SAVE_EVERY
    """Seconds between two searches for files from which a later attempt could resume."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task, which is also its record in the store."""

    row: str
    """Name of the row."""
    stage: str
    """Stage of the task."""
    key: str
    """Key of the task at the time when it ran."""
    state: Literal["done", "failed", "stopped"]
    """Outcome of the task."""
    error: str = ""
    """Reason of its failure, in one sentence."""
    note: str = ""
    """Note for a person about a task that succeeded, for example that a query found nothing."""
    host: str = ""
    """Name of the machine that ran it."""
    seconds: float = 0.0
    """Wall time of its commands, over all recorded attempts."""
    cpu_seconds: float = 0.0
    """CPU time of its commands, over all cores."""
    attempts: int = 1
    """Number of starts."""
    results: tuple[dict[str, Any], ...] = ()
    """Numbers and strings of each command's result, as in `f4x VERB --json`."""
    files: dict[str, int] = field(default_factory=dict)
    """Published file in the row's folder -> bytes."""


def run_task(
    task: Task, settings: Settings, progress: Progress = silent, stopped: Callable[[], bool] = lambda: False
) -> Outcome:
    """Run a task and return its outcome; errors become a failed outcome, only KeyboardInterrupt is raised.

    Args:
        task: a task whose inputs exist.
        settings: the settings of the batch.
        progress: receives the progress of the commands.
        stopped: called often; when it returns True, the commands end as after Ctrl-C.
    """
    try:
        attempt = Attempt(task, settings)
    except F4xError as error:
        return Outcome(task.row, task.stage, task.key, "failed", str(error), socket.gethostname())
    try:
        attempt.run(progress, stopped)
        outcome = attempt.outcome("done")
    except F4xError as error:
        outcome = attempt.outcome("failed", str(error))
    except OSError as error:
        where = f"{socket.gethostname()}, {error.filename or 'its disk'}"
        outcome = attempt.outcome("failed", f"{where}: {error.strerror or error}; make room there, or repair it.")
    except (Cancelled, KeyboardInterrupt) as error:
        outcome = attempt.close(attempt.outcome("stopped"))
        if isinstance(error, KeyboardInterrupt):
            raise
        return outcome
    return attempt.close(outcome)


class Attempt:
    """Attempt at a task, in a folder of its own."""

    def __init__(self, task: Task, settings: Settings):
        """Prepare an attempt without changing any file. Raises F4xError if the store cannot be opened."""
        self.task, self.settings, self.store = task, settings, open_store(settings.url)
        self.busy, self.cpu, self.attempts = 0.0, 0.0, 1
        self.results: list[dict[str, Any]] = []
        self.notes: list[str] = []
        self.published: dict[str, int] = {}
        self.temporary_folders: list[Path] = []
        self.fetched: set[Path] = set()
        self.saved: dict[str, float] = {}
        self.next_save = time.perf_counter() + settings.save_every
        self.log: Path | None = None

    def run(self, progress: Progress, stopped: Callable[[], bool]) -> None:
        """Fetch the inputs, run the commands and publish the results. Raises the error that stopped it."""
        folder = self._make_folder()
        work, self.log = folder / "work", folder / "log"
        work.mkdir()
        with open(self.log, "a", encoding="utf-8") as log:
            print(f"# {socket.gethostname()}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC", file=log, flush=True)
            self._fetch_inputs(work)
            self._restore_saved(work)
            clip = self._clip()
            for command in self.task.commands:
                self._run_command([word if word != CLIP else clip for word in command], work, log, progress, stopped)
        self._publish(work)

    def outcome(self, state: Literal["done", "failed", "stopped"], error: str = "") -> Outcome:
        """Return the outcome with everything that was recorded so far."""
        return Outcome(
            row=self.task.row,
            stage=self.task.stage,
            key=self.task.key,
            state=state,
            error=error,
            note=" ".join(self.notes),
            host=socket.gethostname(),
            seconds=round(self.busy, 3),
            cpu_seconds=round(self.cpu, 3),
            attempts=self.attempts,
            results=tuple(self.results),
            files=self.published,
        )

    def close(self, outcome: Outcome) -> Outcome:
        """Publish the log and the record of the task, and delete all temporary folders on this machine."""
        try:
            if self.log is not None and self.log.exists():
                self.store.publish(self.log, f"{self.task.row}/logs/{self.task.slug}.log")
            if outcome.state != "stopped":
                self.store.write(record_name(self.task), json.dumps(asdict(outcome)).encode())
            if outcome.state == "done":
                self._delete_saved()
        except (F4xError, OSError) as error:  # a full disk cannot take a record either; then the answer alone has it
            reason = outcome.error or f"its record could not be written: {error}"
            outcome = replace(outcome, state="failed" if outcome.state == "done" else outcome.state, error=reason)
        for folder in self.temporary_folders:
            shutil.rmtree(folder, ignore_errors=True)
        return outcome

    def _make_folder(self) -> Path:
        """Return an empty folder: in `scratch` if it is set, else on the disk of a local store, else in the temporary folder."""
        parent = Path(self.settings.scratch) if self.settings.scratch else None
        if parent is None and self.store.local is not None:
            parent = self.store.local / STATE / "work"
        if parent is not None:
            parent.mkdir(parents=True, exist_ok=True)
        self.temporary_folders.append(Path(tempfile.mkdtemp(prefix="f4x-", dir=parent)))
        return self.temporary_folders[0]

    def _clip(self) -> str:
        """Return the path of the clip. A clip behind a URL is downloaded to the same path in every attempt: scenes store it."""
        if URL not in self.task.clip:
            return self.task.clip
        folder = Path(self.settings.scratch or tempfile.gettempdir()) / f"f4x-clip-{self.task.key[:16]}"
        self.temporary_folders.append(folder)
        return str(fetch_tree(self.task.clip, folder))

    def _fetch_inputs(self, work: Path) -> None:
        """Fetch the results of other tasks that this task reads."""
        for stage, wanted in self.task.inputs:
            record = read_record_of(self.store, self.task.row, stage)
            names = [name for name in (record.files if record else ()) if name == wanted or name.startswith(wanted)]
            if not names:
                raise F4xError(f"{self.task.row}: {wanted} of the task '{stage}' is not there; run the batch again.")
            for name in names:
                self._fetch(f"{self.task.row}/{name}", work / name)
                self.fetched.add(work / name)

    def _restore_saved(self, work: Path) -> None:
        """Restore the files of an earlier attempt with the same key."""
        if not self.task.resume_files:
            return
        head: dict[str, Any] = {}
        with contextlib.suppress(ValueError):  # damaged: begun anew
            head = parse_json(self.store.read(self._saved_index) or b"{}")
        if isinstance(head, dict) and head.get("key") == self.task.key:
            self.attempts = head["attempts"] + 1
            self.busy = head["seconds"]
            self.cpu = head["cpu_seconds"]
            for name in head["files"]:
                self._fetch(f"{self._saved_folder}/{name}", work / name)
        else:
            self._delete_saved()

    def _run_command(
        self, words: Sequence[str], work: Path, log: TextIO, progress: Progress, stopped: Callable[[], bool]
    ) -> None:
        """Run one command in a child process. Raises F4xError with its error message, or Cancelled."""
        print("$ f4x", *map(one_line, words), file=log, flush=True)
        program = self.settings.program or (sys.executable, "-m", __package__.split(".")[0])
        threads = dict.fromkeys(THREAD_VARIABLES, str(self.task.threads))
        start, busy, cpu = time.perf_counter(), self.busy, self.cpu

        def tick(used: float) -> None:
            self.busy, self.cpu = busy + time.perf_counter() - start, cpu + used
            if stopped():
                raise Cancelled
            if time.perf_counter() >= self.next_save:
                self._save(work)
                self.next_save = time.perf_counter() + self.settings.save_every

        try:
            ended = run_child(
                [*program, *words, "--progress-json"],
                work,
                progress,
                tick=tick,
                log=log,
                variables=threads | {"PYTHONPATH": str(ROOT)},
            )
        except BaseException:
            self._save(work)
            raise
        self.busy = busy + time.perf_counter() - start
        self.cpu = cpu + ended.cpu_seconds
        result = ended.result()
        self.results.append(_without_lists(result))
        self.notes += filter(None, [result.get("note")])

    @property
    def _saved_folder(self) -> str:
        return f"{self.task.row}/{STATE}/{self.task.slug}"

    @property
    def _saved_index(self) -> str:
        return f"{self._saved_folder}/saved.json"

    def _save(self, work: Path) -> None:
        """Store files that changed since the last call. The index is written last, so it lists complete files only."""
        found = [
            path
            for pattern in self.task.resume_files
            for path in work.glob(pattern)
            if path.is_file() and path not in self.fetched and not path.name.endswith(".part")
        ]
        new = {path.relative_to(work).as_posix(): path for path in found}
        for name, path in new.items():
            with contextlib.suppress(FileNotFoundError):  # replaced at this moment: the next look has it
                changed = path.stat().st_mtime_ns
                if self.saved.get(name) != changed:
                    self.store.publish(path, f"{self._saved_folder}/{name}")
                    self.saved[name] = changed
        # A finished window tidies up.
        self.saved = {name: changed for name, changed in self.saved.items() if name in new}
        head = {"key": self.task.key, "attempts": self.attempts, "seconds": self.busy, "cpu_seconds": self.cpu}
        if self.saved:
            self.store.write(self._saved_index, json.dumps(head | {"files": sorted(self.saved)}).encode())

    def _delete_saved(self) -> None:
        if self.task.resume_files:
            for name in self.store.sizes(self._saved_folder):
                self.store.remove(name)

    def _publish(self, work: Path) -> None:
        """Publish the results, after the old record was deleted and before the new one is written."""
        self.store.remove(record_name(self.task))
        unwanted = ("checkpoints/",) if self.task.kind == "fit" else ()
        for path in sorted(work.rglob("*")):
            name = path.relative_to(work).as_posix()
            if path.is_file() and path not in self.fetched and not name.startswith(unwanted):
                self.published[name] = path.stat().st_size
                self.store.publish(path, f"{self.task.row}/{name}")

    def _fetch(self, name: str, path: Path) -> None:
        try:
            self.store.fetch(name, path)
        except FileNotFoundError as error:
            raise F4xError(f"{name}: is not there any more; run the batch again.") from error


def record_name(task: Task) -> str:
    """Name of a task's record in the store."""
    return f"{task.row}/{STATE}/{task.slug}.json"


def parse_record(data: bytes | None) -> Outcome | None:
    """Return the outcome in a record, without fields that only another version has; None if there is none or it is damaged."""
    try:
        record = parse_json(data) if data is not None else {}
        return Outcome(**{each.name: record[each.name] for each in fields(Outcome) if each.name in record})
    except (ValueError, TypeError, AttributeError):
        return None


def read_record_of(store: Store, row: str, stage: str) -> Outcome | None:
    """Return the record of one stage of a row."""
    return parse_record(store.read(f"{row}/{STATE}/{slug(stage)}.json"))


def _without_lists(result: Any, depth: int = 2) -> Any:
    """Return a verb's result without lists, which may be long: ids of Gaussians, rows for every frame."""
    if isinstance(result, dict) and depth:
        kept = {name: _without_lists(value, depth - 1) for name, value in result.items()}
        return {name: value for name, value in kept.items() if value is not None}
    return result if isinstance(result, int | float | str) else None
