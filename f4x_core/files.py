"""Atomic writing of files: a name always holds either the old content or the complete new one. Conversion to plain JSON data."""

import json
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from .errors import F4xError


@contextmanager
def replace_file(path: Path | str) -> Iterator[BinaryIO]:
    """Yield a seekable binary file that becomes `path` when the block ends without an error.

    The bytes go to a temporary neighbour (same folder, so the rename is atomic), are flushed to the disk and renamed;
    any exception inside removes the neighbour and leaves what was at `path` untouched. A failing disk raises F4xError.
    """
    path = Path(path)
    temporary = None
    try:
        try:
            descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:80]}.", suffix=".part")
            with os.fdopen(descriptor, "w+b") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, _mode_of(path))
            os.replace(temporary, path)
            temporary = None
            _flush_folder(path.parent)
        finally:
            if temporary is not None:
                os.unlink(temporary)
    except OSError as error:
        reason = error.strerror or str(error)
        raise F4xError(
            f"{path}: cannot be written ({reason}); check the folder, its rights and the free space"
        ) from error


def _mode_of(path: Path) -> int:
    """Permission bits the finished file should have: those it had, or the usual ones (mkstemp gives 0600)."""
    try:
        return path.stat().st_mode & 0o777
    except FileNotFoundError:
        return 0o644


def _flush_folder(folder: Path) -> None:
    """Make the rename itself durable; Windows can neither open folders nor needs it."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def json_text(data: Any, indent: int | None = None) -> str:
    """`data` as standard JSON text, see `json_data`; NaN and infinity become null."""
    return json.dumps(json_data(data), indent=indent, allow_nan=False)


def json_data(
    data: Any,
    non_finite: Callable[[float], Any] = lambda value: None,
    unknown: Callable[[Any], Any] = lambda value: value,
) -> Any:
    """Nested data as plain JSON types: dicts with string keys, lists, strings, numbers, booleans and None.

    Arrays and numbers of numpy become lists and numbers of Python.

    Args:
        data: mappings, lists, tuples, arrays and single values, nested in any way.
        non_finite: what replaces NaN and infinity, which JSON lacks; None by default.
        unknown: what replaces a value of any other type; by default it stays, and `json.dumps` refuses it.
    """
    if isinstance(data, Mapping):
        return {str(name): json_data(entry, non_finite, unknown) for name, entry in data.items()}
    if isinstance(data, list | tuple):
        return [json_data(entry, non_finite, unknown) for entry in data]
    if hasattr(data, "tolist"):
        return json_data(data.tolist(), non_finite, unknown)
    if isinstance(data, float):
        return data if math.isfinite(data) else non_finite(data)
    return data if data is None or isinstance(data, str | int) else unknown(data)
