"""`struct Arap` of arap.cpp and its function: the as-rigid-as-possible losses of the scaffold (`scaffold.arap_native`)."""

from __future__ import annotations

from .binder import INT32, INT64, Array, Function, Struct

_XYZ, _AXES = ("frames", "nodes", 3), ("frames", "nodes", 3, 3)
ARAP = Struct(
    "Arap",
    {
        **dict.fromkeys(("edges", "leading"), INT64),
        **dict.fromkeys(("frames", "nodes", "shifts", "threads"), INT32),
        "xyz": Array("float32", _XYZ),
        "axes": Array("float32", _AXES),
        "node": Array("int64", ("edges",)),
        "neighbour": Array("int64", ("edges",)),
        "weight": Array("float32", ("edges",)),
        "shift": Array("int32", ("shifts",)),
        "factor": Array("float32", ("shifts",)),
        "losses": Array("float64", (2,), output=True),
        "d_coordinate": Array("float32", _XYZ, output=True),
        "d_length": Array("float32", _XYZ, output=True),
        "d_axes": Array("float32", _AXES, output=True),
    },
)
F4X_ARAP = Function("f4x_arap", {"problem": ARAP}, INT32)
