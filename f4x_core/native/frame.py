"""Signature of frame.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, Array, Function, Struct

_MAP, _RGB, _IMAGE = ("height", "width"), ("height", "width", 3), ("height", "width", "channels")
FRAME = Struct(
    "Frame",
    {
        **dict.fromkeys(("width", "height", "channels", "threads", "step"), INT32),
        **dict.fromkeys(("moving", "depth_factor", "bend_factor", "alpha_factor", "plain", "min_depth"), FLOAT),
        "image": Array("float32", _IMAGE),
        "depth": Array("float32", _MAP),
        "alpha": Array("float32", _MAP),
        "frame": Array("uint8", _RGB),
        "prior": Array("float32", _MAP),
        "confidence": Array("float16", _MAP),
        "motion": Array("float16", _MAP),
        "target": Array("float32", _RGB, output=True),
        "attention": Array("float32", _MAP, output=True),
        "d_image": Array("float32", _IMAGE, output=True),
        "d_depth": Array("float32", _MAP, output=True),
        "d_alpha": Array("float32", _MAP, output=True),
    },
)
"""`struct Frame` of frame.cpp."""
F4X_FRAME_LOSSES = Function(
    "f4x_frame_losses", {"problem": FRAME, "losses": Array("float64", (2,), output=True)}, INT32
)
