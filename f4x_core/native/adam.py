"""Signature of adam.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, INT64, Array, Function, Struct

_ROWS = ("rows", "width")
ADAM = Struct(
    "Adam",
    {
        "rows": INT64,
        **dict.fromkeys(("width", "threads"), INT32),
        **dict.fromkeys(("rate", "root_correction", "keep_mean", "keep_square", "epsilon"), FLOAT),
        "gradient": Array("float32", _ROWS),
        "reach": Array("float32", ("rows",), optional=True),
        "mean": Array("float32", _ROWS, output=True),
        "square": Array("float32", _ROWS, output=True),
        "value": Array("float32", _ROWS, output=True),
    },
)
"""`struct Adam` of adam.cpp; `width` is at most 16 where there is a `reach`."""
F4X_ADAM = Function("f4x_adam", {"problem": ADAM})
