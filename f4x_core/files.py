"""Writing a file so that its name always holds either the old content or the complete new one; JSON for any reader."""

import json
import math
import os
import tempfile
from collections.abc import Iterator
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
    """`data` as JSON that every reader takes: `finite`."""
    return json.dumps(finite(data), indent=indent, allow_nan=False)


def finite(data: Any) -> Any:
    """Plain JSON data of `data`: NaN and infinity, which JSON lacks, become None; numpy's numbers become Python's."""
    if isinstance(data, dict):
        return {name: finite(entry) for name, entry in data.items()}
    if isinstance(data, list | tuple):
        return [finite(entry) for entry in data]
    if data is None or isinstance(data, str | int):
        return data
    return float(data) if math.isfinite(data) else None
