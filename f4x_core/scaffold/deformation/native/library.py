"""The deformation by the compiled library, for numpy arrays; float32. Needs numpy alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ....errors import F4xError
from ....geometry import pose
from ....native import open_library
from ....native.binder import FLOAT, INT32, INT64, Array, Function, Struct
from ...skinning import FLOOR, MIN_SPREAD, Kernel
from ..reference import COLLAPSED, SIGN_BAND, blend

_TABLES = ("1+times", "pairs", 8)
_POSES = {
    "node_xyz": ("frames", "nodes", 3),
    "node_quat": ("frames", "nodes", 4),
    "radius": ("nodes",),
    "now_xyz": ("times", "nodes", 3),
    "now_quat": ("times", "nodes", 4),
}
RELATIONS = Struct(
    "Relations",
    {
        "pairs": INT64,
        "nodes": INT64,
        **dict.fromkeys(("times", "threads"), INT32),
        **{name: Array("float32", _POSES[name]) for name in ("node_xyz", "node_quat", "radius")},
        "node": Array("int64", ("pairs",)),
        "then": Array("int64", ("pairs",)),
        **{name: Array("float32", _POSES[name]) for name in ("now_xyz", "now_quat")},
        "tables": Array("float32", _TABLES, optional=True, output=True),
        "d_tables": Array("float32", _TABLES, optional=True),
        **{"d_" + name: Array("float32", shape, optional=True, output=True) for name, shape in _POSES.items()},
    },
    sizes=("frames",),
)
"""`struct Relations` of deformation.cpp; what only one of the two passes reads or writes is optional, here and below."""
DEFORMATION = Struct(
    "Deformation",
    {
        "count": INT64,
        "pairs": INT64,
        **dict.fromkeys(("slots", "times", "sigma", "threads"), INT32),
        **dict.fromkeys(("floor", "smallest_spread", "sign_band", "collapsed"), FLOAT),
        "xyz": Array("float32", ("count", 3)),
        "quat": Array("float32", ("count", 4)),
        "index": Array("int32", ("count", "slots")),
        "motions": Array("float32", ("times", "pairs", 8)),
        "nodes": Array("float32", ("pairs", 8), optional=True),
        "mask": Array("bool", ("count", "slots"), optional=True),
        "dw": Array("float32", ("count", "slots"), optional=True),
        "weights": Array("float32", ("count", "slots"), optional=True),
        "strength": Array("float32", ("count",), optional=True),
        "means": Array("float32", ("times", "count", 3), optional=True, output=True),
        "quats": Array("float32", ("times", "count", 4), optional=True, output=True),
        "d_means": Array("float32", ("times", "count", 3), optional=True),
        "d_quats": Array("float32", ("times", "count", 4), optional=True),
        "d_xyz": Array("float32", ("count", 3), optional=True, output=True),
        "d_quat": Array("float32", ("count", 4), optional=True, output=True),
        "d_dw": Array("float32", ("count", "slots"), optional=True, output=True),
        "d_tables": Array("float32", _TABLES, optional=True, output=True),
    },
)
"""`struct Deformation` of deformation.cpp."""
F4X_RELATE = Function("f4x_relate", {"problem": RELATIONS}, INT32)
F4X_RELATE_BACKWARD = Function("f4x_relate_backward", {"problem": RELATIONS}, INT32)
F4X_DEFORM = Function("f4x_deform", {"problem": DEFORMATION}, INT32)
F4X_DEFORM_BACKWARD = Function("f4x_deform_backward", {"problem": DEFORMATION}, INT32)
_RELATED = (*_POSES, "node", "then")
_INPUTS = ("xyz", "quat", "index", "motions", "nodes", "mask", "dw", "weights", "strength")


def move_gaussians(
    dq_table: np.ndarray,
    index: np.ndarray,
    weights: np.ndarray,
    strength: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses `(means (N, 3), quats (N, 4))` of Gaussians moved by `reference.blend`.

    `means` and `quats` are those at the reference times, in the world; the other arguments are those of `blend`. float32
    arrays go through the compiled library where it is there; others, and all where it is not, through numpy.
    """
    floats = dq_table, weights, strength, means, quats
    if open_library()[0] is None or any(a.dtype != np.float32 for a in floats):
        quats, means = pose.compose(*blend(dq_table, index, weights, strength), quats, means)
        return means, quats
    # A frame takes a millisecond or two: not worth starting threads for.
    moved_means, moved_quats = forward(
        {
            "xyz": means,
            "quat": quats,
            "index": index,
            "motions": dq_table[None],
            "weights": weights,
            "strength": None if (strength == 1).all() else strength,
        },
        threads=1,
    )
    return moved_means[0], moved_quats[0]


def relate(arrays: Mapping[str, np.ndarray], threads: int = 1) -> np.ndarray:
    """Return the tables `(1 + T, P, 8)`: `nodes`, then the T `motions` of `forward`. The library must be there.

    `arrays` by name, any strides: `node_xyz (F, M, 3)`, `node_quat (F, M, 4)` of any length, `radius (M,)`, `node (P,)` and
    `then (P,)` each pair's row of (M,) and of (F M), `now_xyz (T, M, 3)`, `now_quat (T, M, 4)` unit. No pair may occur twice.
    """
    held = RELATIONS.plain(arrays, *_RELATED)
    tables = np.empty((1 + len(held["now_xyz"]), len(held["node"]), 8), np.float32)
    _relate(F4X_RELATE, held | {"tables": tables}, threads)
    return tables


def relate_backward(arrays: Mapping[str, np.ndarray], d_tables: np.ndarray, threads: int = 1) -> dict[str, np.ndarray]:
    """Return the gradients of node_xyz, node_quat, radius, now_xyz and now_quat, given that of the tables of `relate`.

    That of `now_quat` means nothing along the quaternion, as in `backward`.
    """
    held = RELATIONS.plain(arrays, *_RELATED)
    got = {name: np.zeros_like(held[name]) for name in _POSES}
    sent = RELATIONS.plain({"d_tables": d_tables}, "d_tables")
    _relate(F4X_RELATE_BACKWARD, held | sent | {"d_" + name: a for name, a in got.items()}, threads)
    return got


def forward(
    arrays: Mapping[str, np.ndarray | None], kernel: Kernel = "sigma", threads: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return `(means (T, N, 3), quats (T, N, 4))` of N Gaussians at T times. The library must be there.

    `arrays` by name, any strides: `xyz (N, 3)`, `quat (N, 4)` of any length, in the frame of the attach node at the
    reference time; `index (N, K)` rows of the P pairs; `motions (T, P, 8)` relative motions; `nodes (P, 8)` position,
    radius and unit quaternion at the reference time; `mask (N, K)` bool; `dw (N, K)` or None. Or, in place of the last
    three, `weights (N, K)` and `strength (N,)` or None for 1: then xyz and quat are in the world, as in `move_gaussians`.

    Raises:
        F4xError: memory ran out.
    """
    held = DEFORMATION.plain(arrays, *_INPUTS)
    times, count = len(held["motions"]), len(held["index"])
    means, quats = np.empty((times, count, 3), np.float32), np.empty((times, count, 4), np.float32)
    _call(F4X_DEFORM, held | {"means": means, "quats": quats}, kernel, threads)
    return means, quats


def backward(
    arrays: Mapping[str, np.ndarray | None], kernel: Kernel, threads: int, d_means: np.ndarray, d_quats: np.ndarray
) -> dict[str, Any]:
    """Return the gradients of `xyz`, `quat`, `dw` and `tables` (nodes, then motions) of `forward` without given weights.

    Bit-equal for every number of threads. The quaternions of `nodes` are taken for normalised ones: their gradients
    are right across the quaternion and mean nothing along it, where a normalisation has none.

    Raises:
        F4xError: memory ran out.
    """
    held = DEFORMATION.plain(arrays, *_INPUTS)
    times, pairs = held["motions"].shape[:2]
    got = {"d_" + name: np.empty_like(held[name]) for name in ("xyz", "quat", "dw") if held.get(name) is not None}
    tables = np.zeros((1 + times, pairs, 8), np.float32)
    sent = DEFORMATION.plain({"d_means": d_means, "d_quats": d_quats}, "d_means", "d_quats")
    _call(F4X_DEFORM_BACKWARD, held | got | sent | {"d_tables": tables}, kernel, threads)
    return {name.removeprefix("d_"): a for name, a in got.items()} | {"tables": tables}


def _relate(function: Function, arrays: dict[str, np.ndarray], threads: int) -> None:
    times, nodes = arrays["now_xyz"].shape[:2]
    pairs, frames = len(arrays["node"]), len(arrays["node_xyz"])
    problem = RELATIONS(pairs=pairs, nodes=nodes, times=times, threads=threads, frames=frames, **arrays)
    if function(problem):
        raise F4xError(
            f"The scaffold ran out of memory at {pairs:,} pairs: give fewer nodes by --set scaffold.max_nodes."
        )


def _call(function: Function, arrays: dict[str, np.ndarray], kernel: Kernel, threads: int) -> None:
    count, slots = arrays["index"].shape
    times, pairs = arrays["motions"].shape[:2]
    problem = DEFORMATION(
        count=count,
        pairs=pairs,
        slots=slots,
        times=times,
        sigma=kernel == "sigma",
        threads=threads,
        floor=FLOOR,
        smallest_spread=MIN_SPREAD,
        sign_band=SIGN_BAND,
        collapsed=COLLAPSED,
        **arrays,
    )
    if function(problem):
        raise F4xError(f"Memory ran out moving {count} Gaussians with {pairs} node poses: use fewer threads.")
