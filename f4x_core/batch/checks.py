"""Checks of a row before any task runs: sentences that cannot be parsed, damaged files, frames outside the clip."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from ..edit.json_files import read_operations
from ..edit.language import parse
from ..edit.operations import Duplicate, Name
from ..edit.request import Request
from ..edit.selects import Text, parts_of
from ..errors import F4xError
from ..fit.vocabulary import EVERYDAY
from ..geometry.trajectory import read_path
from ..query.chat import ChatServer
from ..windows.plan import LENGTHS, plan_windows, usual_overlap
from .graph import declared_frames
from .manifest import Row

FPS, FRAMES = 24.0, 1_000_000
"""Assumed of a clip that was not opened yet, so that no time in a sentence lies outside it."""
parse_cached = lru_cache(1024)(parse)
"""`parse` with a cache, since most rows of a batch have the same sentences."""


def require_values(row: Row) -> None:
    """Raise F4xError for windows, frozen frames, sentences and JSON files that fail whatever the fit gives."""
    if row.window or row.overlap is not None:
        length = row.window or LENGTHS[0]
        plan_windows(0, length, length, usual_overlap(length) if row.overlap is None else row.overlap)
    moments = [path for path in row.paths if path.startswith(("frozen:", "bullet:"))]
    last = declared_frames(row)[0] - 1 if moments else -1
    for path in moments:
        if 0 <= last < float(path.partition(":")[2]):
            raise F4xError(f"paths has {path}, {row.clip} has frames 0 to {last}; choose one of them.")
    if ChatServer.from_environment() is None:  # a model understands more than the grammar
        _require_sentences(row)
    for names, read in ((row.edits, read_operations), (row.paths, read_path)):
        for file in map(Path, names):
            if file.suffix == ".json" and file.is_file():  # a missing file is reported elsewhere
                read(file)


def _require_sentences(row: Row) -> None:
    """Raise F4xError for the first sentence that cannot be parsed, or that names a thing in a scene without text features."""
    labels = (*EVERYDAY, *row.vocabulary) if row.features else ()
    for sentence in row.edits:
        if sentence.endswith(".json"):
            return
        try:
            operations = parse_cached(Request(sentence, labels, fps=FPS, frames=FRAMES))
        except F4xError as error:
            raise F4xError(f"edits has '{sentence}': {error}") from error
        selects = [getattr(one, name) for one in operations for name in ("select", "source") if hasattr(one, name)]
        if not row.features and any(isinstance(part, Text) for select in selects for part in parts_of(select)):
            raise F4xError(
                f"edits has '{sentence}', which names a thing; add the column features, for example text, or say everything."
            )
        if any(isinstance(one, Duplicate | Name) for one in operations):
            return  # later sentences may refer to the copy or the name that this one makes
