"""The deformation by the compiled library, for numpy arrays; float32. Needs numpy alone."""

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import F4xError
from ..geometry import pose
from ..native import address, open_library, require_library
from .deformation import COLLAPSED, SIGN_BAND, blend
from .skinning import FLOOR, SMALLEST_SPREAD, Kernel

_DTYPES = {"index": np.int32, "mask": np.bool_, "node": np.int64, "then": np.int64}
_RELATED = ("node_xyz", "node_quat", "radius", "node", "then", "now_xyz", "now_quat")
_POSES = tuple(name for name in _RELATED if name not in ("node", "then"))
_INPUTS = ("xyz", "quat", "index", "motions", "nodes", "mask", "dw", "weights", "strength")
_OUTPUTS = ("means", "quats", "d_means", "d_quats", "d_xyz", "d_quat", "d_dw", "d_tables")


class _Relations(ctypes.Structure):
    """`struct Relations` of deformation.cpp."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("pairs", "nodes")),
        ("times", ctypes.c_int32),
        *((name, ctypes.c_void_p) for name in (*_RELATED, "tables", "d_tables")),
        *(("d_" + name, ctypes.c_void_p) for name in _POSES),
    ]


class _Deformation(ctypes.Structure):
    """`struct Deformation` of deformation.cpp."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("count", "pairs")),
        *((name, ctypes.c_int32) for name in ("slots", "times", "sigma", "threads")),
        *((name, ctypes.c_float) for name in ("floor", "smallest_spread", "sign_band", "collapsed")),
        *((name, ctypes.c_void_p) for name in _INPUTS + _OUTPUTS),
    ]


def carry(
    dq_table: np.ndarray,
    index: np.ndarray,
    weights: np.ndarray,
    strength: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses `(means (N, 3), quats (N, 4))` of Gaussians moved by `deformation.blend`.

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


def relate(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the tables `(1 + T, P, 8)`: `nodes`, then the T `motions` of `forward`. The library must be there.

    `arrays` by name, any strides: `node_xyz (F, M, 3)`, `node_quat (F, M, 4)` of any length, `radius (M,)`, `node (P,)` and
    `then (P,)` each pair's row of (M,) and of (F M), `now_xyz (T, M, 3)`, `now_quat (T, M, 4)` unit.
    """
    held = _plain(arrays, _RELATED)
    tables = np.empty((1 + len(held["now_xyz"]), len(held["node"]), 8), np.float32)
    _relate("f4x_relate", held | {"tables": tables})
    return tables


def relate_backward(arrays: Mapping[str, np.ndarray], d_tables: np.ndarray) -> dict[str, np.ndarray]:
    """Return the gradients of node_xyz, node_quat, radius, now_xyz and now_quat, given that of the tables of `relate`.

    That of `now_quat` means nothing along the quaternion, as in `backward`.
    """
    held = _plain(arrays, _RELATED)
    got = {name: np.zeros_like(held[name]) for name in _POSES}
    sent = {"d_" + name: a for name, a in got.items()}
    _relate("f4x_relate_backward", held | sent | {"d_tables": np.ascontiguousarray(d_tables, np.float32)})
    return got


def forward(
    arrays: Mapping[str, np.ndarray | None], kernel: Kernel = "sigma", threads: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return `(means (T, N, 3), quats (T, N, 4))` of N Gaussians at T times. The library must be there.

    `arrays` by name, any strides: `xyz (N, 3)`, `quat (N, 4)` of any length, in the frame of the attach node at the
    reference time; `index (N, K)` rows of the P pairs; `motions (T, P, 8)` relative motions; `nodes (P, 8)` position,
    radius and unit quaternion at the reference time; `mask (N, K)` bool; `dw (N, K)` or None. Or, in place of the last
    three, `weights (N, K)` and `strength (N,)` or None for 1: then xyz and quat are in the world, as in `carry`.

    Raises:
        F4xError: memory ran out.
    """
    held = _plain(arrays, _INPUTS)
    times, count = len(held["motions"]), len(held["index"])
    means, quats = np.empty((times, count, 3), np.float32), np.empty((times, count, 4), np.float32)
    _call("f4x_deform", held | {"means": means, "quats": quats}, kernel, threads)
    return means, quats


def backward(
    arrays: Mapping[str, np.ndarray | None], kernel: Kernel, threads: int, d_means: np.ndarray, d_quats: np.ndarray
) -> dict[str, Any]:
    """Return the gradients of `xyz`, `quat`, `dw` and `tables` (nodes, then motions) of `forward` without given weights.

    Bit-equal for an equal number of threads. The quaternions of `nodes` are taken for normalised ones: their gradients
    are right across the quaternion and mean nothing along it, where a normalisation has none.

    Raises:
        F4xError: memory ran out.
    """
    held = _plain(arrays, _INPUTS)
    times, pairs = held["motions"].shape[:2]
    got = {"d_" + name: np.empty_like(held[name]) for name in ("xyz", "quat", "dw") if held.get(name) is not None}
    tables = np.zeros((1 + times, pairs, 8), np.float32)
    sent = _plain({"d_means": d_means, "d_quats": d_quats}, ("d_means", "d_quats"))
    _call("f4x_deform_backward", held | got | sent | {"d_tables": tables}, kernel, threads)
    return {name.removeprefix("d_"): a for name, a in got.items()} | {"tables": tables}


def _plain(arrays: Mapping[str, np.ndarray | None], names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Those of `names` that are there, as plain copies where they are views: the kernel walks bare pointers."""
    return {
        name: np.ascontiguousarray(a, _DTYPES.get(name, np.float32))
        for name in names
        if (a := arrays.get(name)) is not None
    }


def _relate(function: str, arrays: dict[str, np.ndarray]) -> None:
    times, nodes = arrays["now_xyz"].shape[:2]
    addresses = {name: address(a) for name, a in arrays.items()}
    problem = _Relations(pairs=len(arrays["node"]), nodes=nodes, times=times, **addresses)
    getattr(require_library(), function)(ctypes.byref(problem))


def _call(function: str, arrays: dict[str, np.ndarray], kernel: Kernel, threads: int) -> None:
    count, slots = arrays["index"].shape
    times, pairs = arrays["motions"].shape[:2]
    problem = _Deformation(
        count=count,
        pairs=pairs,
        slots=slots,
        times=times,
        sigma=kernel == "sigma",
        threads=threads,
        floor=FLOOR,
        smallest_spread=SMALLEST_SPREAD,
        sign_band=SIGN_BAND,
        collapsed=COLLAPSED,
        **{name: address(a) for name, a in arrays.items()},
    )
    if getattr(require_library(), function)(ctypes.byref(problem)):
        raise F4xError(f"Memory ran out moving {count} Gaussians with {pairs} node poses: use fewer threads.")
