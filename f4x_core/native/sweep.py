"""Struct and function of sweep.cpp: the plane of every pixel (`priors.sweep`)."""

from __future__ import annotations

from .binder import INT32, Array, Function, Struct

_MAP = ("height", "width")
PLANES = Struct(
    "Planes",
    {
        **dict.fromkeys(("width", "height", "planes", "step"), INT32),
        "costs": Array("int16", (*_MAP, "planes")),
        "right": Array("int16", _MAP),
        "below": Array("int16", _MAP),
        "place": Array("float32", _MAP, output=True),
    },
)
"""`struct Planes` of sweep.cpp."""
F4X_BEST_PLANES = Function("f4x_best_planes", {"planes": PLANES})
