"""Signature of picture.cpp. Needs numpy alone."""

from .binder import DOUBLE, FLOAT, INT32, INT64, Array, Function, Result, Struct

_PIXELS = ("height", "width", "channels")
PICTURE = Struct(
    "Picture",
    {
        **dict.fromkeys(("width", "height", "channels", "threads"), INT32),
        "stride": INT64,
        "image": Array("float32", _PIXELS, strides=("width*stride", "stride", 1)),
        "target": Array("float32", _PIXELS),
        "weight": Array("float32", ("height", "width")),
        "window": Array("float32", (11,)),
        "c1": FLOAT,
        "c2": FLOAT,
        "structure": FLOAT,
        "factor": FLOAT,
        "gradient_stride": INT64,
        "gradient": Array(
            "float32", _PIXELS, strides=("width*gradient_stride", "gradient_stride", 1), optional=True, output=True
        ),
    },
)
"""`struct Picture` of picture.cpp."""
F4X_PICTURE_LOSS = Function("f4x_picture_loss", {"problem": PICTURE, "total": Result(DOUBLE)}, INT32)
