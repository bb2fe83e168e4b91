"""Base of moving and copying: ways in widths along the camera's axes, and places beside other things."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ...errors import F4xError
from ...language.degrees import Unit
from ...query.connected_objects import width_along
from ..change import ChangeWithShadow, Vector
from ..selects import SelectKind
from ..state import pivot_of

if TYPE_CHECKING:
    from ..resolve import Settling

GAP = 1.1
"""Things that are put beside one another stand so many half widths of both apart."""
COPY_DISTANCE = 1.2
"""Widths to the next copy: beside the thing, with a gap."""
BESIDE = (COPY_DISTANCE, 0.0, 0.0)
"""Offset of a copy when the sentence gives none, in sizes along the camera's axes."""

LEFT, RIGHT, UP, DOWN = (((None, way, None),) for way in ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)))
"""One step in a direction, as sentences have it."""


class Placing(ChangeWithShadow):
    """Base: a way in `unit` along `axes`, or beside another thing."""

    WAY: ClassVar[str]
    """Name of the field with the way."""
    unit: Unit
    """`size`: in widths of the selection; `pixels`, `pictures`: of the clip, at its depth. Planning makes them world units."""
    axes: Literal["world", "camera"]
    """`camera`: right, down, forward of the clip's camera at the first frame concerned. Planning rewrites it."""
    beside: SelectKind | None
    """It goes beside this thing: the way is that which it then stands from it, or nothing for the nearer side. Planning
    rewrites it."""

    @property
    def way(self) -> Vector:
        """In `unit` along `axes`."""
        return getattr(self, self.WAY)  # type: ignore[no-any-return]

    def require_world(self) -> None:
        """Raise F4xError where planning has not yet settled it."""
        if (self.unit, self.axes) != ("world", "world"):
            raise F4xError(
                "its distances are not in world units along world axes yet; plan the edit, which settles them."
            )

    def settled(self, at: Settling) -> dict[str, Any]:
        fields = super().settled(at) | {"unit": "world", "axes": "world"}
        if self.beside is not None:
            return fields | {"beside": None, self.WAY: self._way_beside(at)}
        move = np.array(self.way)
        if self.unit == "size" and move.any():
            move = move * width_along(at.posed, at.rows, at.axes[:, 0])
        elif self.unit in ("pixels", "pictures"):
            if move[2]:
                raise F4xError("Pixels lie across the picture, not along its depth; say how many widths.")
            move = move * at.pixel * (at.picture if self.unit == "pictures" else 1.0)
        turn = at.axes if self.axes == "camera" else np.eye(3)
        return fields | {self.WAY: vector(turn @ move)}

    def _way_beside(self, at: Settling) -> Vector:
        others = at.rows_of("beside")
        if len(np.intersect1d(at.rows, others)):
            raise F4xError("A thing cannot go beside itself; name two separate things.")
        apart = pivot_of("base", at.means[others]) - pivot_of("base", at.means[at.rows])
        way = np.sign(np.array(self.way))
        if not way.any():  # on the side where it is already, right or left
            way[0] = -1.0 if at.axes[:, 0] @ apart > 0 else 1.0
        axis = int(np.abs(way).argmax())
        widths = [width_along(at.posed, some, at.axes[:, axis]) for some in (at.rows, others)]
        gap = widths[1] if axis == 1 and way[1] < 0 else widths[0] if axis == 1 else GAP * sum(widths) / 2
        return vector(apart + at.axes @ way * gap)

    def further(self, factor: float) -> Vector:
        """Return the shift, `factor` times as far where it is in widths."""
        x, y, z = self.way
        return (factor * x, factor * y, factor * z) if self.unit == "size" else (x, y, z)


def vector(values: np.ndarray) -> Vector:
    """Return three numbers as plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
