"""The plan of an edit in words that a person can check: widths and directions in the picture, frames with their seconds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.camera import Camera
from ..query.connected_objects import width_along
from ..scene import Scene
from ..scene.model import PosedSplats
from .apply import edited, with_operations
from .change import Change, Vector
from .resolve import rows_of, splat_rows
from .stack import of

SLIGHT = 0.02
"""A part of a way is told from this fraction of its longest part on."""


def plan_lines(scene: Scene, operations: Sequence[Change], frame: float = 0.0) -> Iterator[str]:
    """Yield a line for each of the resolved `operations`, as the camera at its first frame, else at `frame`, sees it."""
    scene, fps = edited(scene), scene.fps
    for operation in operations:
        line = as_seen(scene, operation, frame) + _share(scene, operation)
        yield re.sub(r"\bframe ([\d.]*\d)", lambda found: f"frame {found[1]} ({float(found[1]) / fps:.1f} s)", line)
        scene = with_operations(scene, operation)


def _share(scene: Scene, operation: Change) -> str:
    """Return the share of the scene that an operation is for: " (11 % of the scene's Gaussians)"; "" for all of it, and for two."""
    if not operation.ACTS or hasattr(operation, "other"):
        return ""
    rows, along = rows_of(scene, operation.select), getattr(operation, "along", None)
    if along is not None:
        rows = np.union1d(rows, rows_of(scene, along))
    share = len(rows) / max(int((~splat_rows(scene).gone).sum()), 1)
    return "" if share == 1 else f" ({share:.{0 if share >= 0.1 else 1}%} of the scene's Gaussians)".replace("%", " %")


def sizes(scene: Scene) -> dict[int, tuple[int, ...]]:
    """Return a dictionary from the id of each edit in effect to its number of Gaussians; two numbers for an exchange of places."""
    found: dict[int, list[int]] = {}
    for step in getattr(scene, "steps", ()):
        found.setdefault(step.edit.id, []).append(int(step.chosen.sum()))
    swaps = {edit.id for edit in of(scene).edits if hasattr(edit.operation, "other")}
    each = {edit.id for edit in of(scene).edits if getattr(edit.operation, "each", ())}
    return {
        id: tuple(counts if id in swaps else [sum(counts)] if id in each else counts[:1])
        for id, counts in found.items()
    }


@dataclass(frozen=True, eq=False)
class Seen:
    """The Gaussians that an operation is for, as the camera at a moment sees them."""

    scene: Scene
    rows: np.ndarray
    """(n,) of `scene.posed`."""
    time: float
    """Clip frame."""

    @cached_property
    def camera(self) -> Camera:
        """The clip's camera at that moment."""
        return self.scene.cameras.at(self.time)

    @cached_property
    def axes(self) -> np.ndarray:
        """(3,3) the camera's right, down, forward as columns."""
        return self.camera.camera_to_world[:3, :3]

    @cached_property
    def posed(self) -> PosedSplats:
        """The scene's Gaussians at that moment."""
        return self.scene.posed(self.time)

    @property
    def means(self) -> np.ndarray:
        """(n,3) centers."""
        return self.posed.means[self.rows]

    def in_widths(self, way: Vector) -> Vector:
        """Return a shift of the world in widths of the Gaussians along the camera's axes; slight parts become 0."""
        width = max(width_along(self.posed, self.rows, self.axes[:, 0]), 1e-9) if len(self.rows) else 1.0
        seen = self.axes.T @ np.array(way) / width
        x, y, z = (float(np.round(part, 2)) if abs(part) >= SLIGHT * np.abs(seen).max() else 0.0 for part in seen)
        return x, y, z


def as_seen(scene: Scene, operation: Change, frame: float = 0.0) -> str:
    """Return a resolved operation in words, with shifts in widths of the thing and rotations as the camera then sees them."""
    time = operation.span[0] if operation.span else frame
    return operation.as_seen(Seen(scene, rows_of(scene, operation.select), time))
