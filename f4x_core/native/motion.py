"""Signatures of motion.cpp. Needs numpy alone."""

from .binder import FLOAT, INT32, Array, Function, Struct

_XYZ, _QUAT, _AXES = ("frames", "nodes", 3), ("frames", "nodes", 4), ("frames", "nodes", 3, 3)
MOTION = Struct(
    "Motion",
    {
        **dict.fromkeys(("frames", "nodes", "threads"), INT32),
        **dict.fromkeys(("velocity", "acceleration", "spin", "spin_change"), FLOAT),
        "xyz": Array("float32", _XYZ),
        "quat": Array("float32", _QUAT),
        "times": Array("float64", ("frames",)),
        "axes": Array("float32", _AXES, optional=True, output=True),
        "d_axes": Array("float32", _AXES, optional=True),
        "loss": Array("float64", (1,), optional=True, output=True),
        "d_xyz": Array("float32", _XYZ, optional=True, output=True),
        "d_quat": Array("float32", _QUAT, optional=True, output=True),
    },
)
"""`struct Motion` of motion.cpp; what only one of the two functions reads or writes is optional."""
F4X_NODE_AXES = Function("f4x_node_axes", {"problem": MOTION})
F4X_NODE_MOTION = Function("f4x_node_motion", {"problem": MOTION}, INT32)
