"""Structs and functions of maps.cpp: samples of a map (`priors.flow`), a smooth map through samples (`priors.depth`)."""

from __future__ import annotations

from .binder import DOUBLE, INT32, INT64, Array, Function, Struct

_MAP, _IMAGE = ("height", "width"), ("height", "width", "channels")
SAMPLES = Struct(
    "Samples",
    {
        "count": INT64,
        **dict.fromkeys(("width", "height", "channels"), INT32),
        "halves": Array("float16", _IMAGE, optional=True),
        "floats": Array("float32", _IMAGE, optional=True),
        "points": Array("float64", ("count", 2)),
        "values": Array("float64", ("count", "channels"), output=True),
    },
)
"""`struct Samples` of maps.cpp; one of `halves` and `floats` is the map."""
SMOOTHING = Struct(
    "Smoothing",
    {
        **dict.fromkeys(("width", "height", "iterations"), INT32),
        "tolerance": DOUBLE,
        **{
            name: Array("float64", _MAP)
            for name in ("itself", "right", "right_two", "below", "below_two", "weight", "sample")
        },
        "solution": Array("float64", _MAP, output=True),
    },
)
"""`struct Smoothing` of maps.cpp."""
F4X_SAMPLE_MAP = Function("f4x_sample_map", {"samples": SAMPLES})
F4X_SMOOTH_MAP = Function("f4x_smooth_map", {"smoothing": SMOOTHING})
