"""Files of operations and of selections that a person wrote or another program left."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import F4xError
from .operations import Operation, read_operation

MAX_BYTES = 64 << 20
"""Of a file of operations or a selection: those of millions of Gaussians take less."""


def read_operations(path: Path) -> list[Operation]:
    """The operations of a JSON file: a list of objects, or one. F4xError names the file and the operation."""
    data = read_json(path, "a list of operations")
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise F4xError(f"{path}: it holds no operation; write a list of them.")
    return [read_operation(entry, f"{path}: operation {number}") for number, entry in enumerate(entries, 1)]


def read_json(path: Path, wanted: str) -> Any:
    """Return the content of the JSON file `path`; F4xError says that it is no `wanted`."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise F4xError(f"{path}: it is larger than {MAX_BYTES >> 20} MiB; give {wanted}.")
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError as error:
        raise F4xError(f"{path}: its brackets are nested too deep to be read; give {wanted}.") from error
    except ValueError as error:
        raise F4xError(f"{path}: it is not JSON ({error}); give {wanted}.") from error
