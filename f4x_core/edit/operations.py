"""The operations of edit stacks by name, and reading them. Each is a file of `edit.operation`, where new ones are found, too."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Union, get_args

from . import operation as _folder
from .change import (
    DIRECTIONS,
    KINDS,
    MAX_NUMBER,
    MAX_SCALE,
    NOTHING_ALONG,
    SHOWN,
    Change,
    ChangeWithShadow,
    Span,
    Vector,
)
from .operation.blur import Blur
from .operation.duplicate import MAX_COPIES, Duplicate
from .operation.glow import Glow
from .operation.grade import Grade
from .operation.match import Match
from .operation.name import Name
from .operation.opacity import Opacity
from .operation.pace import Freeze, Loop, Retime, Reverse
from .operation.recolour import Recolour
from .operation.rekey import Rekey
from .operation.remove import Delete, Extract
from .operation.style import Style
from .operation.swap import Swap
from .operation.take_back import TakeBack
from .operation.transform import Transform
from .records import read_record

__all__ = [
    "DIRECTIONS", "KINDS", "MAX_COPIES", "MAX_NUMBER", "MAX_SCALE", "NOTHING_ALONG", "SHOWN", "Blur", "Change",
    "ChangeWithShadow", "Delete", "Duplicate", "Extract", "Freeze", "Glow", "Grade", "Loop", "Match", "Name", "Opacity",
    "Operation", "Recolour", "Rekey", "Retime", "Reverse", "Span", "Style", "Swap", "TakeBack", "Transform", "Vector",
    "kinds", "read_operation",
]  # fmt: skip

Operation = Union[  # noqa: UP007  # read at run time
    Recolour, Opacity, Delete, Extract, Transform, Duplicate, Freeze, Retime, Reverse, Loop, Style, Match, Grade, Blur, Glow, Swap,
    Name, Rekey, TakeBack,
]  # fmt: skip
"""Any operation, in the order in which a sentence is read as one."""

for _file in iter_modules(_folder.__path__):
    import_module(f"{_folder.__name__}.{_file.name}")


def kinds() -> tuple[type[Change], ...]:
    """Return the classes of operations, those without a name here last."""
    return tuple(dict.fromkeys((*get_args(Operation), *KINDS.values())))


def read_operation(data: object, where: str = "operation") -> Operation:
    """Return the operation that a JSON object describes; F4xError begins with `where`."""
    return read_record(Union[kinds()], data, where)  # noqa: UP007  # built from values
