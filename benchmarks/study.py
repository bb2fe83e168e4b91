"""A study of the report: a question, the function that measures, and its findings as plain data."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from f4x_core.errors import F4xError
from f4x_core.files import json_data, replace_file
from f4x_core.progress import Progress, silent

from .machine import describe_machine, digest_source
from .timing import time_in_turn

Row = dict[str, Any]
"""Column -> a number, word, truth value or None (not measured); a column's unit stands in brackets at its end."""

SECTIONS = {
    "limit": "Share of the physical limit",
    "speed": "Speed against error",
    "stability": "Hard cases",
    "needs": "What a scene needs",
    "ablations": "Ablations",
    "clips": "Clips",
    "datasets": "The field's data sets",
    "blender": "In Blender",
}
"""Parts of the report, in the order of the page."""


@dataclass(frozen=True)
class Table:
    """Measured rows."""

    name: str
    """Of the CSV file too: short, with hyphens."""
    rows: list[Row]
    title: str = ""
    """Title of the table."""
    timed: tuple[str, ...] = ()
    """Columns that hold times, or what follows from them: the only ones that differ from run to run."""
    note: str = ""
    """Remarks needed to read it: settings, source of the figures, their limits."""


@dataclass(frozen=True)
class Figure:
    """A plot of two columns of a table."""

    title: str
    table: str
    """Name of the table whose rows are the points."""
    x: str
    y: str
    """Columns; rows in which either is None are left out. `x` may hold words, on an axis that isn't logarithmic."""
    series: str = ""
    """Column whose values part the points into lines ("" = one line)."""
    low: str = ""
    high: str = ""
    """Columns with the ends of error bars: of `x` where their name starts with its, else of `y`."""
    log: str = "xy"
    """Logarithmic axes."""
    where: Row = field(default_factory=dict)
    """Only rows that have these values in these columns."""
    front: bool = False
    """Draw the Pareto front (less is better on both axes) in place of lines through the points."""


@dataclass
class Findings:
    """Rows, figures and sentences of a study."""

    tables: list[Table] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    """Sentences for the page, made from the rows: what was reached, what wasn't and why."""
    skipped: list[str] = field(default_factory=list)
    """Things not measured, each with the reason."""
    failed: list[str] = field(default_factory=list)
    """Statements that did not hold; any entry makes `f4x report` exit with 1."""


@dataclass(frozen=True)
class Study:
    """One question and where its answer is measured."""

    name: str
    section: str
    title: str
    question: str
    """Question that the study answers, in one sentence."""
    measure: str
    """`.module:function` of this room, called with a Context; imported when it is run."""
    seed_tables: tuple[str, ...] = ()
    """Tables of the Feature4X supplement beside which it stands."""
    only_full: bool = False
    """Too long for `--quick`."""

    def function(self) -> Callable[[Context], Findings]:
        """Return the function that measures."""
        module, _, name = self.measure.partition(":")
        return getattr(import_module(module, __package__), name)


@dataclass(frozen=True)
class Context:
    """Inputs of a study."""

    folder: Path
    """Its own folder: steps that are done, scenes that later steps read."""
    quick: bool = False
    """Small sizes, few repeats: the whole report in minutes."""
    clips: Path | None = None
    """Folder of real clips, CLIP/images beside CLIP/masks; None = studies of real clips are skipped."""
    data: Path | None = None
    """Folder of the field's data sets."""
    cases: Path | None = None
    """Folder of the hard cases; None = where a checkout has them."""
    threads: int = 1
    seed: int = 0
    progress: Progress = silent
    taken: list[Row] = field(default_factory=list)
    """Origin of the steps that an earlier run measured: `source`, `machine`, `seconds` of each."""

    @property
    def repeats(self) -> int:
        """Return the number of rounds of a timing."""
        return 3 if self.quick else 9

    def choose(self, quick: Any, full: Any) -> Any:
        """Return one of two values: that of a quick report, or that of the full one."""
        return quick if self.quick else full

    def step(self, name: str, work: Callable[[], Any], **settings: Any) -> Any:
        """Return the result of `work` (JSON data), of now or of an earlier run with the same settings.

        A report that was stopped goes on after its last step, so a step is as long as one likes to lose. Which code and
        machine measured it, and for how long, is kept with it.
        """
        file = self.folder / "steps" / f"{name}.json"
        settings = json.loads(json.dumps(settings | {"quick": self.quick, "seed": self.seed, "threads": self.threads}))
        if file.is_file():
            done = read_json(file)
            if done.get("settings") == settings and "source" in done:  # before, steps did not say who measured them
                self.taken.append({name: done[name] for name in ("source", "machine", "seconds")})
                return done["result"]
        self.progress("report", 0, 0, f"{self.folder.name}: {name}")
        start = time.perf_counter()
        result = work()
        seconds = round(time.perf_counter() - start, 1)
        file.parent.mkdir(parents=True, exist_ok=True)
        about = {"source": digest_source(), "machine": describe_machine(), "seconds": seconds}
        write_json(file, {"settings": settings, **about, "result": result})
        return json.loads(json.dumps(as_plain(result)))

    def clip(self, name: str) -> Path:
        """Return the folder of a real clip; MissingError where there is none (the runner turns it into `skipped`)."""
        if self.clips is None or not (self.clips / name / "images").is_dir():
            raise MissingError(f"{name}: no such clip; --clips DIR names the folder that holds {name}/images.")
        return self.clips / name


class MissingError(F4xError):
    """Raised where this machine lacks something that a study needs; the study is skipped with this sentence."""


def time_rows(
    names: Sequence[str],
    functions: Sequence[Callable[[], object]],
    repeats: int,
    unit: str = "ms",
    column: str = "time",
) -> list[Row]:
    """Return rows of `name` and the columns `time_columns(column, unit)`: median and quartiles, timed in turn."""
    factor = {"ms": 1e3, "s": 1.0}[unit]
    rows = []
    for name, seconds in zip(names, time_in_turn(functions, repeats), strict=True):
        low, middle, high = statistics.quantiles([factor * s for s in seconds], n=4, method="inclusive")
        rows.append({"name": name, **dict(zip(time_columns(column, unit), (middle, low, high), strict=True))})
    return rows


def time_columns(column: str = "time", unit: str = "ms") -> tuple[str, str, str]:
    """Return the names of the columns that hold the median of some times and its quartiles."""
    middle = f"{column} ({unit})"
    return middle, *span_columns(middle)


def span_columns(column: str) -> tuple[str, str]:
    """Return the columns of the range of the column `NAME (unit)`: `NAME low (unit)`, `NAME high (unit)`."""
    name, bracket, unit = column.partition(" (")
    return f"{name} low{bracket}{unit}", f"{name} high{bracket}{unit}"


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the points than which no other is as good on both axes (less is better), by rising x."""
    front, best = [], math.inf
    for index in sorted(range(len(points)), key=lambda i: points[i]):
        if points[index][1] < best:
            front.append(index)
            best = points[index][1]
    return front


def as_plain(value: Any) -> Any:
    """Return a result as JSON data. NaN and infinity become words; a path and other types that JSON lacks become text."""
    return json_data(value, non_finite=str, unknown=str)


def write_json(file: Path, data: Any) -> None:
    """Write JSON data, atomically."""
    with replace_file(file) as out:
        out.write((json.dumps(as_plain(data), indent=1, ensure_ascii=False) + "\n").encode())


def read_json(file: Path) -> Any:
    """Return the JSON data of a file; F4xError where it is none."""
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise F4xError(f"{file}: is not JSON ({error}); delete it and run the report again.") from error
