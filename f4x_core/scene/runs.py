"""Node poses as runs: one stored pose for all frames over which a node stays where it is, to the bit. numpy.

A scene joined of the windows of a long clip has thousands of nodes, each of which moves in a window or two and is held before
and after. Interpolation between knots would store no fewer poses than that where nodes do move: fitted poses of neighbouring
frames differ by pixels from any smooth curve.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import F4xError
from ..reading import FREE_BYTES, MAX_INFLATION, OWN_LIMIT
from .model import SCAFFOLD_ARRAYS

HELD = "scaffold/held"
"""(R,) int32: over how many frames each stored pose holds, the runs of one node after those of another."""
OF_POSES = ("scaffold/xyz", "scaffold/quat", "scaffold/certain")
"""The arrays (F,M,...) that are stored as (R,...), one row a run."""
MAX_POSES = 1 << 26
"""Nodes x frames that runs may unfold to, 1.9 GB: a file says with few bytes that they are many. More are stored one by one."""
POSE_BYTES = 29
"""Bytes of a pose in `OF_POSES`."""
BLOCK = 256
"""Nodes whose poses are compared at once."""


def _unfolds(poses: int, stored: int) -> bool:
    """Return True where so many poses may be read of a file whose arrays take `stored` bytes."""
    return poses <= MAX_POSES and poses * POSE_BYTES <= max(FREE_BYTES, MAX_INFLATION * stored)


def run_lengths(poses: Sequence[np.ndarray]) -> np.ndarray:
    """Return `HELD` of `poses`, arrays (F,M,...) of all frames: a run goes on for as long as none of them changes a bit."""
    frames, nodes = poses[0].shape[:2]
    starts = np.ones((nodes, frames), bool)
    for first in range(0, nodes, BLOCK):
        block = slice(first, first + BLOCK)
        changed = np.zeros((frames - 1, len(starts[block])), bool)
        for array in poses:
            part = np.ascontiguousarray(array[:, block])
            bits = part.view(np.uint8).reshape(*part.shape[:2], -1)  # 0 and -0 are equal numbers
            changed |= (bits[1:] != bits[:-1]).any(-1)
        starts[block, 1:] = changed.T
    return np.diff(np.flatnonzero(starts), append=starts.size).astype("<i4")


def fold(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays of a file with its node poses as runs, or as they are where that takes no fewer bytes."""
    if OF_POSES[0] not in arrays or not 0 < arrays[OF_POSES[-1]].size <= MAX_POSES:
        return arrays
    poses = [arrays[name] for name in OF_POSES]
    held = run_lengths(poses)
    frames, nodes = poses[0].shape[:2]
    full = sum(array.nbytes for array in poses)
    stored = held.nbytes + POSE_BYTES * len(held)
    others = sum(array.nbytes for array in arrays.values()) - full
    if stored >= full or not _unfolds(frames * nodes, others + stored):
        return arrays
    node, frame = np.divmod(np.cumsum(held, dtype=np.int64) - held, frames)
    return {**arrays, **{name: arrays[name][frame, node] for name in OF_POSES}, HELD: held}


def unfold(arrays: dict[str, np.ndarray]) -> None:
    """Put all poses in the place of runs, and take `HELD` out; F4xError unless the runs fill every frame of every node."""
    held = arrays.pop(HELD)
    wanted = {name: arrays[name] for name in ("scaffold/times", "scaffold/ids", *OF_POSES) if name in arrays}
    if len(wanted) < 5 or any(array.ndim == 0 for array in wanted.values()):
        raise F4xError(f"{HELD} is there without the arrays that it belongs to")
    frames, nodes = len(wanted["scaffold/times"]), len(wanted["scaffold/ids"])
    if not _unfolds(frames * nodes, held.nbytes + sum(array.nbytes for array in arrays.values())):
        raise F4xError(
            f"{HELD} stands for {frames} x {nodes} poses; more than {MAX_POSES}, or than {MAX_INFLATION} times its bytes, is"
            f" {OWN_LIMIT}"
        )
    # A run ends where its node's frames end, or the next node would begin amid it.
    fits = held.ndim == 1 and held.dtype == np.dtype("<i4") and len(held) > 0 and held.min() > 0
    ends = np.cumsum(held, dtype=np.int64) if fits else np.zeros(1, np.int64)
    if not fits or ends[-1] != frames * nodes or not np.isin(np.arange(1, nodes + 1) * frames, ends).all():
        raise F4xError(f"{HELD} does not fill {frames} frames of each of {nodes} nodes")
    for name in OF_POSES:
        rows, (dtype, axes) = wanted[name], SCAFFOLD_ARRAYS[name.removeprefix("scaffold/")]
        shape = len(held), *axes[2:]
        if rows.shape != shape or rows.dtype != dtype:
            raise F4xError(
                f"{name} is {rows.dtype} {rows.shape}, expected {np.dtype(dtype)} {shape}, as {HELD} is there"
            )
        poses = np.repeat(rows, held, axis=0).reshape(nodes, frames, *rows.shape[1:])
        arrays[name] = np.ascontiguousarray(poses.swapaxes(0, 1))
        arrays[name].flags.writeable = False
