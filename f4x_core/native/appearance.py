"""Signatures of appearance.cpp. Needs numpy alone."""

from typing import Any

from .binder import FLOAT, INT32, INT64, Array, Function, Struct

_ONE, _TWO, _XYZ, _QUAT = (("count", *width) for width in ((), (2,), (3,), (4,)))
_COLORS, _MORE = ("count", "channels"), ("count", "more_coefficients", 3)
_STRIDES: dict[str, Any] = {"first": ("first_stride", 1), "more": ("more_stride", 3, 1)}
_DRAWN = {"means": _XYZ, "quats": _QUAT, "scales": _XYZ, "opacities": _ONE}
APPEARANCE = Struct(
    "Appearance",
    {
        "count": INT64,
        **dict.fromkeys(("coefficients", "threads", "channels", "first_stride", "more_stride"), INT32),
        "mark": FLOAT,
        "centre": FLOAT * 3,
        "first": Array("float32", _XYZ, strides=_STRIDES["first"]),
        "more": Array("float32", _MORE, optional=True, strides=_STRIDES["more"]),
        "means": Array("float32", _XYZ),
        "quats": Array("float32", _QUAT),
        "there": Array("float32", _XYZ, optional=True),
        "colors": Array("float32", _COLORS, optional=True, output=True),
        "log_scales": Array("float32", _XYZ, optional=True),
        "logits": Array("float32", _ONE, optional=True),
        "log_lifetimes": Array("float32", _TWO, optional=True),
        "born": Array("float32", _ONE, optional=True),
        **dict.fromkeys(("time", "whole", "margin"), FLOAT),
        "drawn_means": Array("float32", _XYZ, optional=True, output=True),
        "drawn_quats": Array("float32", _QUAT, optional=True, output=True),
        "scales": Array("float32", _XYZ, optional=True, output=True),
        "opacities": Array("float32", _ONE, optional=True, output=True),
        "sent": Array("float32", _COLORS, optional=True),
        **{"sent_" + name: Array("float32", shape, optional=True) for name, shape in _DRAWN.items()},
        "d_first": Array("float32", _XYZ, optional=True, output=True, strides=_STRIDES["first"]),
        "d_more": Array("float32", _MORE, optional=True, output=True, strides=_STRIDES["more"]),
        "d_means": Array("float32", _XYZ, optional=True, output=True),
        "d_quats": Array("float32", _QUAT, optional=True, output=True),
        "d_there": Array("float32", _XYZ, optional=True, output=True),
        "d_log_scales": Array("float32", _XYZ, optional=True, output=True),
        "d_logits": Array("float32", _ONE, optional=True, output=True),
        "d_log_lifetimes": Array("float32", _TWO, optional=True, output=True),
    },
    sizes=("more_coefficients",),
)
"""`struct Appearance` of appearance.cpp; what only one of the two passes reads or writes is optional."""
F4X_APPEARANCE = Function("f4x_appearance", {"problem": APPEARANCE})
F4X_APPEARANCE_BACKWARD = Function("f4x_appearance_backward", {"problem": APPEARANCE})
