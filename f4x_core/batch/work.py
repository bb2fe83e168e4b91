"""Doing one task: fetch what it takes, run its commands in a child, publish what they left, and record that it is done.

A row's folder holds the ordinary files of its commands, `logs/STAGE.log`, and below `.batch/` a record for each task. A record is
written last, so that a task is done entirely or not at all. While a long task works, the files from which it can go on are kept
in `.batch/STAGE/`: another attempt, on this machine or another, starts from them.
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
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TextIO

from ..errors import Cancelled, F4xError
from ..processes import EXIT_INTERRUPTED, Ended, run_child
from ..progress import Progress, silent
from .graph import CLIP, Task, slug
from .storage import URL, Store, fetch_tree, open_store

STATE = ".batch"
"""Folder, in a batch and in each row, of what is the batch's own."""
SAVE_EVERY = 5.0
"""Seconds between two looks for files that a later attempt could go on from."""
ROOT = Path(__file__).resolve().parents[2]
"""Where the package lies: a child finds this very code, installed or not."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Libraries take all cores unless told otherwise; a task has its own and no more."""


@dataclass(frozen=True)
class Settings:
    """How tasks are worked on, the same for all of a batch."""

    url: str
    """Of the store."""
    scratch: str | None = None
    """Folder for work in progress, on the machine that does it; None: inside a local store, else the machine's own."""
    program: tuple[str, ...] | None = None
    """What runs a command; None: the `f4x` of the machine that does it."""
    save_every: float = SAVE_EVERY
    """Seconds between two looks for files that a later attempt could go on from."""


@dataclass(frozen=True)
class Outcome:
    """What became of a task; also its record."""

    row: str
    """Name of the row."""
    stage: str
    """Of the task."""
    key: str
    """Of the task, as it was done."""
    state: Literal["done", "failed", "stopped"]
    """How it ended."""
    error: str = ""
    """Why it failed: one sentence."""
    note: str = ""
    """What a person should know of a task that is done: that nothing answers to a word."""
    host: str = ""
    """Name of the machine that worked on it."""
    seconds: float = 0.0
    """Wall time of its commands, of all attempts that are known of."""
    cpu_seconds: float = 0.0
    """Time of all their cores."""
    overhead: float = 0.0
    """Wall seconds beside the commands, of the last attempt: fetching, publishing, records."""
    memory: int = 0
    """Most bytes that a command held."""
    attempts: int = 1
    """How often it was begun."""
    results: tuple[dict[str, Any], ...] = ()
    """Numbers and words that each command told, as `f4x VERB --json`."""
    files: dict[str, int] = field(default_factory=dict)
    """Published file in the row's folder -> bytes."""


def run_task(
    task: Task, settings: Settings, progress: Progress = silent, stopped: Callable[[], bool] = lambda: False
) -> Outcome:
    """Work on a task to its end, whatever that is; only KeyboardInterrupt goes through.

    Args:
        task: whose needed tasks are done.
        settings: of the batch.
        progress: told what the commands tell.
        stopped: looked at often; when it says yes, the commands end as after Ctrl-C.
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
        outcome = attempt.outcome("failed", f"{where}: {error.strerror or error}; make room there, or mend it.")
    except (Cancelled, KeyboardInterrupt) as error:
        outcome = attempt.close(attempt.outcome("stopped"))
        if isinstance(error, KeyboardInterrupt):
            raise
        return outcome
    return attempt.close(outcome)


class Attempt:
    """One attempt at a task, in a folder of its own."""

    def __init__(self, task: Task, settings: Settings):
        """Nothing is touched yet; F4xError where the store cannot be opened."""
        self.task, self.settings, self.store = task, settings, open_store(settings.url)
        self.start = time.perf_counter()
        self.busy, self.before, self.cpu, self.memory, self.attempts = 0.0, 0.0, 0.0, 0, 1
        self.results: list[dict[str, Any]] = []
        self.notes: list[str] = []
        self.published: dict[str, int] = {}
        self.rubbish: list[Path] = []
        self.taken: set[Path] = set()
        self.saved: dict[str, float] = {}
        self.next_save = self.start + settings.save_every
        self.log: Path | None = None

    def run(self, progress: Progress, stopped: Callable[[], bool]) -> None:
        """All of it; raises what went wrong."""
        folder = self._make_folder()
        work, self.log = folder / "work", folder / "log"
        work.mkdir()
        with open(self.log, "a", encoding="utf-8") as log:
            print(f"# {socket.gethostname()}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC", file=log, flush=True)
            self._take(work)
            self._take_saved(work)
            clip = self._clip()
            for command in self.task.commands:
                self._command([word if word != CLIP else clip for word in command], work, log, progress, stopped)
        self._publish(work)

    def outcome(self, state: Literal["done", "failed", "stopped"], error: str = "") -> Outcome:
        """What there is to tell."""
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
            overhead=round(time.perf_counter() - self.start - (self.busy - self.before), 3),
            memory=self.memory,
            attempts=self.attempts,
            results=tuple(self.results),
            files=self.published,
        )

    def close(self, outcome: Outcome) -> Outcome:
        """Bring the log home, record what became of the task, and leave nothing behind on this machine."""
        try:
            if self.log is not None and self.log.exists():
                self.store.publish(self.log, f"{self.task.row}/logs/{self.task.slug}.log")
            if outcome.state != "stopped":
                self.store.write(record_name(self.task), json.dumps(asdict(outcome)).encode())
            if outcome.state == "done":
                self._forget_saved()
        except (F4xError, OSError) as error:  # a full disk cannot take a record either; then the answer alone has it
            told = outcome.error or f"its record could not be written: {error}"
            outcome = replace(outcome, state="failed" if outcome.state == "done" else outcome.state, error=told)
        for folder in self.rubbish:
            shutil.rmtree(folder, ignore_errors=True)
        return outcome

    def _make_folder(self) -> Path:
        """An empty folder on the disk of the store, where it is one of this machine's and nothing else was asked for."""
        parent = Path(self.settings.scratch) if self.settings.scratch else None
        if parent is None and self.store.local is not None:
            parent = self.store.local / STATE / "work"
        if parent is not None:
            parent.mkdir(parents=True, exist_ok=True)
        self.rubbish.append(Path(tempfile.mkdtemp(prefix="f4x-", dir=parent)))
        return self.rubbish[0]

    def _clip(self) -> str:
        """The clip as a path. One behind a URL is fetched to a place that is the same for every attempt: scenes name it."""
        if URL not in self.task.clip:
            return self.task.clip
        folder = Path(self.settings.scratch or tempfile.gettempdir()) / f"f4x-clip-{self.task.key[:16]}"
        self.rubbish.append(folder)
        return str(fetch_tree(self.task.clip, folder))

    def _take(self, work: Path) -> None:
        """Fetch the files of other tasks that this one reads."""
        for stage, wanted in self.task.takes:
            record = read_record_of(self.store, self.task.row, stage)
            names = [name for name in (record.files if record else ()) if name == wanted or name.startswith(wanted)]
            if not names:
                raise F4xError(f"{self.task.row}: {wanted} of the task '{stage}' is not there; run the batch again.")
            for name in names:
                self._fetch(f"{self.task.row}/{name}", work / name)
                self.taken.add(work / name)

    def _take_saved(self, work: Path) -> None:
        """Begin where an earlier attempt with the same key was."""
        if not self.task.saves:
            return
        head: dict[str, Any] = {}
        with contextlib.suppress(ValueError):  # damaged: begun anew
            head = json.loads(self.store.read(self._saved_head) or b"{}")
        if head.get("key") == self.task.key:
            self.attempts = head["attempts"] + 1
            self.busy = self.before = head["seconds"]
            self.cpu = head["cpu_seconds"]
            for name in head["files"]:
                self._fetch(f"{self._saved_folder}/{name}", work / name)
        else:
            self._forget_saved()

    def _command(
        self, words: Sequence[str], work: Path, log: TextIO, progress: Progress, stopped: Callable[[], bool]
    ) -> None:
        """Run one command in a child; raises its sentence, or Cancelled."""
        print("$ f4x", *words, file=log, flush=True)
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
        self.memory = max(self.memory, ended.memory)
        if "result" in ended.last:
            self.results.append(_brief(ended.last["result"]))
            self.notes += filter(None, [ended.last["result"].get("note")])
            return
        if ended.code == EXIT_INTERRUPTED:
            raise Cancelled
        raise F4xError(ended.last.get("error") or _how_it_died(ended))

    @property
    def _saved_folder(self) -> str:
        return f"{self.task.row}/{STATE}/{self.task.slug}"

    @property
    def _saved_head(self) -> str:
        return f"{self._saved_folder}/saved.json"

    def _save(self, work: Path) -> None:
        """Keep what changed since the last look; the head, written last, tells of whole files only."""
        found = [
            path
            for pattern in self.task.saves
            for path in work.glob(pattern)
            if path.is_file() and path not in self.taken and not path.name.endswith(".part")
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
            self.store.write(self._saved_head, json.dumps(head | {"files": sorted(self.saved)}).encode())

    def _forget_saved(self) -> None:
        if self.task.saves:
            for name in self.store.sizes(self._saved_folder):
                self.store.remove(name)

    def _publish(self, work: Path) -> None:
        """Put the results in place, after an old record is gone and before the new one is there."""
        self.store.remove(record_name(self.task))
        unwanted = ("checkpoints/",) if self.task.kind == "fit" else ()
        for path in sorted(work.rglob("*")):
            name = path.relative_to(work).as_posix()
            if path.is_file() and path not in self.taken and not name.startswith(unwanted):
                self.published[name] = path.stat().st_size
                self.store.publish(path, f"{self.task.row}/{name}")

    def _fetch(self, name: str, path: Path) -> None:
        try:
            self.store.fetch(name, path)
        except FileNotFoundError as error:
            raise F4xError(f"{name}: is not there any more; run the batch again.") from error


def record_name(task: Task) -> str:
    """The record of a task in the store."""
    return f"{task.row}/{STATE}/{task.slug}.json"


def parse_record(data: bytes | None) -> Outcome | None:
    """What a record says; None where there is none, or one that nobody can read."""
    try:
        return None if data is None else Outcome(**json.loads(data))
    except (ValueError, TypeError):
        return None


def read_record_of(store: Store, row: str, stage: str) -> Outcome | None:
    """The record of a row's stage."""
    return parse_record(store.read(f"{row}/{STATE}/{slug(stage)}.json"))


def _brief(result: Any, depth: int = 2) -> Any:
    """A verb's result without its lists, which may be long: ids of Gaussians, rows for every frame."""
    if isinstance(result, dict) and depth:
        kept = {name: _brief(value, depth - 1) for name, value in result.items()}
        return {name: value for name, value in kept.items() if value is not None}
    return result if isinstance(result, int | float | str) else None


def _how_it_died(ended: Ended) -> str:
    if ended.code < 0:
        return (
            f"it was ended by signal {-ended.code} while it held {ended.memory / 1e9:.1f} GB; most often the memory does not"
            " suffice: use a smaller width, or fewer tasks at a time."
        )
    return f"it ended with {ended.code}: {ended.tail.splitlines()[-1] if ended.tail else 'without a word'}"
