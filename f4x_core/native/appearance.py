"""Signatures of appearance.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, INT64, Array, Function, Struct

_SH, _XYZ, _QUAT = ("count", "coefficients", 3), ("count", 3), ("count", 4)
APPEARANCE = Struct(
    "Appearance",
    {
        "count": INT64,
        "coefficients": INT32,
        "threads": INT32,
        "centre": FLOAT * 3,
        "sh": Array("float32", _SH),
        "means": Array("float32", _XYZ),
        "quats": Array("float32", _QUAT),
        "colors": Array("float32", _XYZ, optional=True, output=True),
        "sent": Array("float32", _XYZ, optional=True),
        "d_sh": Array("float32", _SH, optional=True, output=True),
        "d_means": Array("float32", _XYZ, optional=True, output=True),
        "d_quats": Array("float32", _QUAT, optional=True, output=True),
    },
)
"""`struct Appearance` of appearance.cpp; what only one of the two passes reads or writes is optional."""
F4X_APPEARANCE = Function("f4x_appearance", {"problem": APPEARANCE})
F4X_APPEARANCE_BACKWARD = Function("f4x_appearance_backward", {"problem": APPEARANCE})
