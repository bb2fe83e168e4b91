"""Files of operations and of selections that a person wrote or another program left."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import F4xError
from ..reading import load_json
from .operations import Operation, read_operation


def read_operations(path: Path) -> list[Operation]:
    """Return the operations of a JSON file: a list of objects, or one. F4xError names the file and the operation."""
    data = read_json(path, "a list of operations")
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise F4xError(f"{path}: it holds no operation; write a list of them.")
    return [read_operation(entry, f"{path}: operation {number}") for number, entry in enumerate(entries, 1)]


def read_json(path: Path, wanted: str) -> Any:
    """Return the content of the JSON file `path`; F4xError says that it is no `wanted`."""
    try:
        return load_json(path)
    except ValueError as error:
        raise F4xError(f"{path}: it cannot be read as JSON ({error}); give {wanted}.") from error
