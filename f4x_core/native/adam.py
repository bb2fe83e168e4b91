"""Signatures of adam.cpp. Needs numpy alone."""

import ctypes
from collections.abc import Sequence
from typing import Any

from ..errors import F4xError
from .binder import FLOAT, INT32, INT64, POINTER, Array, Function, Struct

_ROWS = ("rows", "width")
ADAM = Struct(
    "Adam",
    {
        "rows": INT64,
        "width": INT32,
        **dict.fromkeys(("rate", "root_correction", "keep_mean", "keep_square", "epsilon"), FLOAT),
        "gradient": Array("float32", _ROWS),
        "reach": Array("float32", ("rows",), optional=True),
        "cap": Array("float32", ("rows",), optional=True),
        "mean": Array("float32", _ROWS, output=True),
        "square": Array("float32", _ROWS, output=True),
        "value": Array("float32", _ROWS, output=True),
    },
)
"""`struct Adam` of adam.cpp; `width` is at most 16 where there is a `reach` or a `cap`."""
F4X_ADAM = Function("f4x_adam", {"problems": POINTER, "count": INT64, "threads": INT32}, INT32)


def take_steps(problems: Sequence[Any], threads: int) -> None:
    """Step every tensor, an `ADAM` each. Raises F4xError where memory runs out."""
    addresses = (POINTER * len(problems))(*map(ctypes.addressof, problems))
    if F4X_ADAM(addresses, len(problems), threads):
        raise F4xError("A step of the fit ran out of memory: fit fewer Gaussians, by --memory.")
