"""What can be told of a row before any task: sentences that nobody understands, files and frames that are not as it says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from ..clip.stream import claimed_frames
from ..edit.json_files import read_operations
from ..edit.language import parse
from ..edit.operations import Duplicate, Name
from ..edit.selects import Text, parts_of
from ..errors import F4xError
from ..fit.vocabulary import EVERYDAY
from ..geometry.trajectory import read_path
from ..query.chat import ChatServer
from .manifest import Row
from .storage import URL

UNKNOWN: dict[str, Any] = {"fps": 24.0, "frames": 1_000_000}
"""Of a clip that nobody has opened yet: no time that a sentence says lies outside."""
understand = lru_cache(1024)(parse)
"""Most rows of a batch say the same."""


def require_values(row: Row) -> None:
    """Raise F4xError for what no clip could make right: lengths of windows, and sentences that nobody understands."""
    if row.window or row.overlap is not None:
        from .windows import LENGTH, OVERLAP, plan_windows  # imports the whole fit

        length = row.window or LENGTH
        plan_windows(0, length, length, OVERLAP if row.overlap is None else row.overlap)
    if ChatServer.from_environment() is None:  # a model understands more than the grammar
        _require_sentences(row)


def faults_of(row: Row) -> Iterator[str]:
    """Sentences about files that are there and are not what the row says of them; the row's tasks would fail."""
    checks: list[Callable[[], Any]] = []
    if URL not in row.clip and Path(row.clip).expanduser().exists():
        checks.append(partial(_require_frames, row))
    for names, read in ((row.edits, read_operations), (row.paths, read_path)):
        checks += [partial(read, Path(name)) for name in names if name.endswith(".json") and Path(name).is_file()]
    for check in checks:
        try:
            check()
        except F4xError as error:
            yield str(error)


def _require_frames(row: Row) -> None:
    """F4xError where the clip cannot be opened, or has not the frames and moments that the row speaks of."""
    count = claimed_frames(row.clip, row.frames)
    moments = [path.removeprefix("frozen:") for path in row.paths if path.startswith("frozen:")]
    for moment in moments if count else ():
        if float(moment) > count - 1:
            raise F4xError(f"paths has frozen:{moment}, the clip has frames 0 to {count - 1}; choose one of them.")


def _require_sentences(row: Row) -> None:
    """F4xError for the first sentence that means nothing, or names a thing in a scene that knows no words."""
    labels = (*EVERYDAY, *row.vocabulary) if row.features else ()
    for sentence in row.edits:
        if sentence.endswith(".json"):
            return
        try:
            operations = understand(sentence, labels=labels, **UNKNOWN)
        except F4xError as error:
            raise F4xError(f"edits has '{sentence}': {error}") from error
        selects = [getattr(one, name) for one in operations for name in ("select", "source") if hasattr(one, name)]
        if not row.features and any(isinstance(part, Text) for select in selects for part in parts_of(select)):
            raise F4xError(
                f"edits has '{sentence}', which names a thing; add the column features, for example text, or say everything."
            )
        if any(isinstance(one, Duplicate | Name) for one in operations):
            return  # later sentences may speak of what this one makes, as of what a file does
