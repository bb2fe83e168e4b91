"""New poses of scaffold nodes."""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...errors import F4xError
from ...language.lexicon import plural
from ..change import Change, Reply, check_numbers
from ..selects import Moving, SelectKind


@dataclass(frozen=True)
class Rekey(Change):
    """New poses of scaffold nodes, set by an artist. Make it with `Rekey.of`.

    It changes the scene's own motion, wherever it stands in the stack: what was retimed shows it at its moments, copies too.
    Between two of its `times`, and at the other knots of the scaffold, everything stays as it was.
    """

    TAG = "rekey"
    nodes: tuple[int, ...]
    """n ids of nodes, each once."""
    times: tuple[float, ...]
    """F clip frames, increasing."""
    poses: str
    """Base64 of (F,n,7) little-endian float32: x, y, z, then the rotation wxyz."""
    select: ClassVar[SelectKind] = Moving()  # type: ignore[misc]  # whoever follows the nodes

    def __post_init__(self) -> None:
        if not self.nodes or not self.times:
            raise F4xError("it names no node or no time; give at least one of each.")
        if len(set(self.nodes)) < len(self.nodes):
            raise F4xError("a node is named twice; give each once.")
        check_numbers("times", self.times)
        if any(a >= b for a, b in zip(self.times, self.times[1:], strict=False)):
            raise F4xError("times do not increase; give clip frames in order, each once.")
        try:
            size = len(base64.b64decode(self.poses, validate=True))
        except (binascii.Error, ValueError) as error:
            raise F4xError("poses is no base64; write the motion back anew.") from error
        if size != 28 * len(self.times) * len(self.nodes):
            raise F4xError(f"poses holds {size} bytes, not 28 for each node and time; write the motion back anew.")
        xyz, quat = self.arrays
        if not (np.isfinite(quat).all() and quat.any(-1).all()):
            raise F4xError("poses holds a rotation that is zero or not finite; write the motion back anew.")
        check_numbers("poses", xyz.ravel())

    ACTS = False
    UNCOVERS = True
    REKEYS = True

    @classmethod
    def of(cls, nodes: np.ndarray, times: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> Rekey:
        """Pack poses `xyz (F,n,3)`, `quat (F,n,4)` of the nodes with ids `nodes (n,)` at clip frames `times (F,)`."""
        packed = np.concatenate([xyz, quat], axis=-1).astype("<f4")
        names = tuple(np.asarray(nodes).tolist()), tuple(np.asarray(times, float).tolist())
        return cls(*names, base64.b64encode(packed.tobytes()).decode())

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """(xyz (F,n,3), quat (F,n,4)) float32."""
        poses = np.frombuffer(base64.b64decode(self.poses), "<f4").reshape(len(self.times), len(self.nodes), 7)
        return poses[..., :3], poses[..., 3:]

    def described(self) -> str:
        count, first, last = len(self.nodes), self.times[0], self.times[-1]
        return f"move {count} {plural('node', count)} of the scaffold, frames {first:g} to {last:g}"

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        return ()
