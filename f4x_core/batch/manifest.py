"""The manifest of a batch: a glob, a CSV or a JSON file becomes one `Row` for each clip."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import PurePosixPath
from typing import Any, get_args, get_type_hints

from ..clip.read import ALPHA, LAYOUT, parse_span
from ..edit.records import Record, near, read_record
from ..errors import F4xError
from ..features.teachers import TEACHERS
from ..raster import CPU_BACKENDS
from ..reading import parse_json
from ..scene.formats import FORMATS
from ..scene.view import CHANNELS
from .storage import expand, join, read_bytes

SEPARATOR = ";"
"""Separates the entries of a list in a CSV cell, because sentences contain commas."""
NOTHING = "none"
"""Marks an empty list in a CSV cell; an empty cell means the default."""
DELIMITERS = ",;\t"
"""Accepted delimiters of a CSV: spreadsheets avoid the comma in countries where it is the decimal separator."""
NAME = re.compile(r"(?!(con|prn|aux|nul|com\d|lpt\d)(\.|$))\w([\w.-]{0,98}[\w-])?", re.IGNORECASE)
"""Valid names of rows: folder names on every file system. Windows reserves some for devices and drops a final dot."""
SILENT = ("#", "sep=")
"""Prefixes of CSV lines that are skipped."""
PARENT, STEM = "{parent}", "{stem}"
"""Placeholders in a name for the folder that contains the clip, and for the clip's file name."""
MIN_VALUES = {"threads": 1, "parts": 1, "seed": 0, "width": 2, "hold_out": 2, "window": 0}
"""Column -> minimum value; the command line has the same limits."""
PATHS = re.compile(r"original|orbit|stabilise|(frozen|bullet):\d+(\.\d+)?|slow:([1-9]\d?(\.\d+)?|100)|.+\.json")
"""Valid entries of the column `paths`."""
KNOWN_PATHS = ("original", "orbit", "stabilise", "slow:FACTOR", "bullet:T", "frozen:T", "FILE.json")
"""Kinds of paths, for people."""
BACKENDS = ("auto", *CPU_BACKENDS)
"""Values of the column `backend`."""
PAGE = "index.html"
"""File name of the batch's page, beside the folders of the rows."""


@dataclass(frozen=True)
class Row(Record):
    """Clip and the work on it; each field is a column of the manifest.

    Options of `f4x fit` have the same names there; None means its default.
    """

    clip: str
    """Video, image folder or data set, as a path or URL; relative to the folder of the CSV or JSON file."""
    name: str = ""
    """Name of the row and its folder; `{parent}` and `{stem}` stand for parts of the clip's path; empty: the clip's name."""
    profile: str | None = None
    """Profile of the fit, which decides the amount of work."""
    frames: str | None = None
    """Frames to use, A:B:S."""
    width: int | None = None
    """Picture width in pixels."""
    hold_out: int | None = None
    """Keep frames with index % N == N-1 for measuring."""
    window: int | None = None
    """Number of frames to fit at a time; 0: the whole clip at once."""
    overlap: int | None = None
    """Frames that neighbouring windows share."""
    masks: str | None = None
    """Folder with masks of moving objects, `layout`, or `alpha`."""
    provider: str | None = None
    """Provider of all priors."""
    cameras: str | None = None
    """Provider of the cameras."""
    depth: str | None = None
    """Provider of the depth."""
    prior: tuple[str, ...] = ()
    """Priors from files, each NAME=PATH."""
    settings: tuple[str, ...] = ()
    """Settings of the profile to change, each NAME=VALUE, as `f4x fit --set` takes them."""
    seed: int = 0
    """Seed of everything random."""
    threads: int = 1
    """Cores that each task of the row uses; results are bit-equal for an equal number."""
    backend: str = "auto"
    """Raster backend."""
    features: tuple[str, ...] = ()
    """Teachers whose features are distilled into the scene."""
    vocabulary: tuple[str, ...] = ()
    """Words whose embeddings are stored in the scene."""
    queries: tuple[str, ...] = ()
    """Words to query; each gets masks and a heat map."""
    edits: tuple[str, ...] = ()
    """Edits in order: sentences, or JSON files of operations."""
    paths: tuple[str, ...] = ("original",)
    """Camera paths to render: original, orbit, stabilise, slow:FACTOR, bullet:T, frozen:T, or a JSON file."""
    channels: tuple[str, ...] = ("rgb",)
    """Channels to render."""
    parts: int = 1
    """Number of tasks that render each path, in parallel if cores are free."""
    exports: tuple[str, ...] = ()
    """Formats to which all frames are exported."""

    def __post_init__(self) -> None:
        """Raise F4xError for values that no task could use."""
        if not self.clip:
            raise F4xError("the clip is empty; name a video or a folder of pictures.")
        for name, minimum in MIN_VALUES.items():
            value = getattr(self, name)
            if value is not None and value < minimum:
                raise F4xError(f"{name} is {value}; give {minimum} or more.")
        parse_span(self.frames)
        drawn = (*CHANNELS, *(("latent", *self.features) if self.features else ()), "mask:LABEL")
        for column, known, accepts in (
            ("exports", FORMATS, FORMATS.__contains__),
            ("features", TEACHERS, TEACHERS.__contains__),
            ("channels", drawn, lambda name: name in drawn or name.startswith("mask:")),
            ("paths", KNOWN_PATHS, PATHS.fullmatch),
            ("backend", BACKENDS, BACKENDS.__contains__),
        ):
            value = getattr(self, column)
            for name in (value,) if isinstance(value, str) else value:
                if not accepts(name):
                    raise F4xError(f"{column} has {name!r}{near(name, known)}; known: {', '.join(known)}.")
        if self.queries and not self.features:
            raise F4xError("queries need features, which say what is what; add the column features, for example text.")


def read_manifest(source: str, defaults: Mapping[str, str] | None = None) -> tuple[Row, ...]:
    """Return the rows of a CSV or JSON file, or of the clips that a glob finds.

    Args:
        source: FILE.csv with a head line; FILE.json, a list of objects; otherwise a pattern. Local or a URL.
        defaults: column -> cell as in a CSV, for rows that leave the column empty.

    Raises:
        F4xError: it cannot be read, a column is unknown, a value is wrong, or two rows would write into one folder.
    """
    given = _cells(defaults or {}, "--set")
    suffix = PurePosixPath(source).suffix.lower()
    if suffix in (".csv", ".json"):
        rows = (_csv_rows if suffix == ".csv" else _json_rows)(source, _text(source), given)
        folder = source.replace("\\", "/").rpartition("/")[0]
        rows = [_located(row, folder) for row in rows]
    else:
        clips = expand(source)
        if not clips:
            raise F4xError(f"{source}: no clip is there; give a pattern in quotes, a CSV or a JSON file.")
        rows = [read_record(Row, given | {"clip": clip}, f"{source}, {clip}") for clip in clips]
    return _named(rows, source)


def _text(source: str) -> str:
    try:
        return read_bytes(source).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise F4xError(f"{source}: is not UTF-8 text ({error.reason}); save it as CSV UTF-8.") from error


def _csv_rows(source: str, text: str, given: Mapping[str, Any]) -> list[Row]:
    """Return the rows of a CSV file, without empty lines, comments with # and the `sep=;` of a spreadsheet."""
    rows: list[Row] = []
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith(SILENT)), "")
    delimiter = max(DELIMITERS, key=first.count)
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        head: list[str] = []
        for cells in reader:
            where = f"{source}, line {reader.line_num}"
            if not any(map(str.strip, cells)) or cells[0].startswith(SILENT):
                continue
            if not head:
                head = _head(cells, where)
                continue
            if len(cells) != len(head):
                raise F4xError(
                    f"{where}: it has {len(cells)} cells, the head {len(head)} columns; put a cell that holds {delimiter!r}"
                    " in quotes."
                )
            rows.append(read_record(Row, {**given, **_cells(dict(zip(head, cells, strict=True)), where)}, where))
    except csv.Error as error:
        raise F4xError(f"{source}: is no CSV ({error}); save it as comma-separated values.") from error
    if not rows:
        raise F4xError(f"{source}: has no rows; the first line names the columns, each further line is a clip.")
    return rows


def _head(cells: Sequence[str], where: str) -> list[str]:
    """Return the columns that the first line names."""
    names = [cell.strip() for cell in cells]
    _cells(dict.fromkeys(names, ""), where)
    for name in names:
        if names.count(name) > 1:
            raise F4xError(f"{where}: the column '{name}' is there {names.count(name)} times; leave one.")
    return names


def _json_rows(source: str, text: str, given: Mapping[str, Any]) -> list[Row]:
    try:
        data = parse_json(text)
    except ValueError as error:
        raise F4xError(f"{source}: is no JSON ({error}); write a list of objects.") from error
    if not isinstance(data, list) or not data:
        raise F4xError(f"{source}: write a list of objects with at least one, [{{'clip': 'a.mp4'}}].".replace("'", '"'))
    rows = []
    for number, entry in enumerate(data, 1):
        merged = {**given, **entry} if isinstance(entry, dict) else entry
        rows.append(read_record(Row, merged, f"{source}, row {number}"))
    return rows


@cache
def _hints() -> dict[str, Any]:
    """Return the types of a row's fields; finding them takes longer than reading a row."""
    return get_type_hints(Row)


def _cells(cells: Mapping[str, str], where: str) -> dict[str, Any]:
    """Convert cells to the fields' types, without empty ones; invalid numbers stay text, which `read_record` refuses."""
    hints = _hints()
    values: dict[str, Any] = {}
    for column, cell in cells.items():
        name, cell = column.strip(), cell.strip()
        if name not in hints:
            known = ", ".join(entry.name for entry in fields(Row))
            raise F4xError(f"{where}: there is no column '{name}'{near(name, hints)}; known: {known}.")
        if not cell:
            continue
        hint = hints[name]
        if getattr(hint, "__origin__", None) is tuple:
            parts = [part.strip() for part in cell.split(SEPARATOR)] if cell != NOTHING else []
            values[name] = [part for part in parts if part]
        elif hint is int or int in get_args(hint):
            values[name] = int(cell) if re.fullmatch(r"[+-]?\d+", cell) else cell
        else:
            values[name] = cell
    return values


def _located(row: Row, folder: str) -> Row:
    """Return the row with its paths, which are relative to the manifest's folder, seen from where we are."""

    def file(text: str) -> str:
        return join(folder, text)

    def json_file(text: str) -> str:
        return file(text) if text.endswith(".json") else text

    return replace(
        row,
        clip=file(row.clip),
        masks=file(row.masks) if row.masks not in (None, LAYOUT, ALPHA) else row.masks,
        prior=tuple("=".join((name, file(path))) for name, _, path in (entry.partition("=") for entry in row.prior)),
        edits=tuple(map(json_file, row.edits)),
        paths=tuple(map(json_file, row.paths)),
    )


def _named(rows: Sequence[Row], source: str) -> tuple[Row, ...]:
    """Return the rows with a name each; F4xError where two are the same, also on file systems that know no case."""
    named: list[Row] = []
    seen: dict[str, tuple[int, str]] = {}
    for number, row in enumerate(rows, 1):
        name = _name_of(row)
        if not NAME.fullmatch(name) or name.lower() == PAGE:
            raise F4xError(
                f"{source}, row {number}: '{name}' cannot name a folder everywhere; use letters, digits, _ . and -."
            )
        if name.lower() in seen:
            other, clip = seen[name.lower()]
            raise F4xError(
                f"{source}: rows {other} ({clip}) and {number} ({row.clip}) would both write the folder '{name}'; give them"
                f" different names in the column name, or all with --set 'name={PARENT}_{STEM}'."
            )
        seen[name.lower()] = number, row.clip
        named.append(replace(row, name=name))
    return tuple(named)


def _name_of(row: Row) -> str:
    """Return the row's name. By default the last part of the clip's path; for a folder `images`, its parent's name."""
    *folders, last = ["", *(part for part in row.clip.replace("\\", "/").split("/") if part not in ("", "images"))]
    parts = {PARENT: (folders or [""])[-1], STEM: PurePosixPath(last).stem}
    name = row.name or STEM
    for word, part in parts.items():
        name = name.replace(word, re.sub(r"[^\w.-]+", "_", part).strip("_.-"))
    return name
