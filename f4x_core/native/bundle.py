"""`struct Sightings` of bundle.cpp and its functions: the sums of bundle adjustment, in float64 (`priors.bundle`)."""

from __future__ import annotations

from .binder import DOUBLE, INT32, INT64, Array, Function, Struct

_COUPLING = (3, "unknowns*frames+1", "points")
SIGHTINGS = Struct(
    "Sightings",
    {
        "count": INT64,
        **dict.fromkeys(("frames", "points", "unknowns", "centers", "lens", "shared"), INT32),
        **dict.fromkeys(("robust", "behind", "min_depth"), DOUBLE),
        "principal": DOUBLE * 2,
        "frame": Array("int64", ("count",)),
        "point": Array("int64", ("count",)),
        "uv": Array("float64", ("count", 2)),
        "weight": Array("float64", ("count",)),
        "rotation": Array("float64", ("frames", 3, 3)),
        "center": Array("float64", ("frames", 3)),
        "focal": Array("float64", ("frames",)),
        "homogeneous": Array("float64", ("points", 4)),
        "tangents": Array("float64", ("points", 4, 3), optional=True),
        "costs": Array("float64", ("frames",), optional=True, output=True),
        "blocks": Array("float64", ("frames", 7, 7), optional=True, output=True),
        "slopes": Array("float64", ("frames", 7), optional=True, output=True),
        "coupling": Array("float64", _COUPLING, optional=True, output=True),
        "point_blocks": Array("float64", ("points", 3, 3), optional=True, output=True),
        "point_slopes": Array("float64", ("points", 3), optional=True, output=True),
    },
)
"""`struct Sightings` of bundle.cpp; what only some calls read or write is optional."""
F4X_BUNDLE_COSTS = Function("f4x_bundle_costs", {"sightings": SIGHTINGS})
F4X_BUNDLE_EQUATIONS = Function("f4x_bundle_equations", {"sightings": SIGHTINGS})
