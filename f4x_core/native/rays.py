"""Signatures of rays.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, Array, Function, Struct

_MATRICES, _COLORS, _PIXELS = ("count", 3, 3), ("count", 3), ("height", "width", 4)
RAYS = Struct(
    "Rays",
    {
        **dict.fromkeys(("count", "width", "height", "threads"), INT32),
        **dict.fromkeys(("fx", "fy", "cx", "cy", "near_plane", "alpha_min"), FLOAT),
        "means": Array("float32", ("count", 3)),
        "whiten": Array("float32", _MATRICES),
        "opacities": Array("float32", ("count",)),
        "radii": Array("float32", ("count",)),
        "boxes": Array("float32", ("count", 4)),
        "colors": Array("float32", _COLORS),
        "image": Array("float32", _PIXELS, optional=True, output=True),
        "d_image": Array("float32", _PIXELS, optional=True),
        "d_whiten": Array("float32", _MATRICES, optional=True, output=True),
        "d_opacities": Array("float32", ("count",), optional=True, output=True),
        "d_colors": Array("float32", _COLORS, optional=True, output=True),
    },
)
"""`struct Rays` of rays.cpp; what only one of the two functions reads or writes is optional."""
F4X_RAYS = Function("f4x_rays", {"problem": RAYS}, INT32)
F4X_RAYS_BACKWARD = Function("f4x_rays_backward", {"problem": RAYS}, INT32)
