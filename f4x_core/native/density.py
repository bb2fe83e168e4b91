"""Signatures of density.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, INT64, Array, Function, Struct

PULLS = Struct(
    "Pulls",
    {
        "count": INT64,
        "threads": INT32,
        **dict.fromkeys(("across", "down"), FLOAT),
        "gradient": Array("float32", ("count", 2)),
        "visible": Array("bool", ("count",)),
        "gradient_sum": Array("float32", ("count",), output=True),
        "seen": Array("float32", ("count",), output=True),
    },
)
"""`struct Pulls` of density.cpp."""
F4X_RECORD_PULLS = Function("f4x_record_pulls", {"problem": PULLS})
