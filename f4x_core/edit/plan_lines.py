"""The plan of an edit in words that a person can check: widths and directions in the picture, frames with their seconds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..query.connected_objects import width_along
from ..scene import Scene
from .apply import edited, with_operations
from .description import describe, steps_in_words, whom, whom_with
from .operations import Blur, Duplicate, Name, Operation, Rekey, Swap, TakeBack, Transform, Vector
from .resolve import rows_of, splat_rows
from .stack import of

SLIGHT = 0.02
"""A part of a way is told from this fraction of its longest part on."""


def plan_lines(scene: Scene, operations: Sequence[Operation], frame: float = 0.0) -> Iterator[str]:
    """One line for each of the resolved `operations`, as the camera at its first frame, else at `frame`, sees it."""
    scene, fps = edited(scene), scene.fps
    for operation in operations:
        line = as_seen(scene, operation, frame) + _share(scene, operation)
        yield re.sub(r"\bframe ([\d.]*\d)", lambda found: f"frame {found[1]} ({float(found[1]) / fps:.1f} s)", line)
        scene = with_operations(scene, operation)


def _share(scene: Scene, operation: Operation) -> str:
    """Return the share of the scene that an operation is for: " (11 % of the scene's Gaussians)"; "" for all of it, and for two."""
    if isinstance(operation, Rekey | TakeBack | Name | Swap):
        return ""
    share = len(rows_of(scene, operation.select)) / max(int((~splat_rows(scene).gone).sum()), 1)
    return "" if share == 1 else f" ({share:.{0 if share >= 0.1 else 1}%} of the scene's Gaussians)".replace("%", " %")


def sizes(scene: Scene) -> dict[int, tuple[int, ...]]:
    """Id of an edit in effect -> how many Gaussians it is for; of two things that change places, of each."""
    found: dict[int, list[int]] = {}
    for step in getattr(scene, "steps", ()):
        found.setdefault(step.edit.id, []).append(int(step.chosen.sum()))
    swaps = {edit.id for edit in of(scene).edits if isinstance(edit.operation, Swap)}
    each = {edit.id for edit in of(scene).edits if getattr(edit.operation, "each", ())}
    return {
        id: tuple(counts if id in swaps else [sum(counts)] if id in each else counts[:1])
        for id, counts in found.items()
    }


def as_seen(scene: Scene, operation: Operation, frame: float = 0.0) -> str:
    """A resolved operation in words, its ways in widths of the thing and its turns as the camera at that frame sees them."""
    if not isinstance(operation, Transform | Duplicate | Swap | Blur):
        return describe(operation)
    span = None if isinstance(operation, Duplicate) else operation.frames
    time = span[0] if span else frame
    rows = rows_of(scene, operation.select)
    if isinstance(operation, Blur):
        camera = scene.cameras.at(time)
        depths = camera.project(scene.posed(time).means[rows])[1]
        depth = np.median(depths[depths > 0]) if (depths > 0).any() else np.inf
        return f"{describe(operation)} ({operation.radius * camera.focal / depth:.1f} pixels where it is)"
    axes = scene.cameras.at(time).camera_to_world[:3, :3]  # columns: right, down, forward
    width = max(width_along(scene.posed(time).means[rows], axes[:, 0]), 1e-9) if len(rows) else 1.0

    def seen(vector: Vector) -> Vector:
        """A world vector in widths along the camera's axes; what is slight beside the rest is none."""
        way = axes.T @ np.array(vector) / width
        x, y, z = (float(np.round(part, 2)) if abs(part) >= SLIGHT * np.abs(way).max() else 0.0 for part in way)
        return x, y, z

    who = whom(operation.select)
    if isinstance(operation, Swap):
        way = steps_in_words(seen(operation.shift or (0.0, 0.0, 0.0)))
        return f"{describe(operation)}: {who} goes {way or 'nowhere'}, {whom(operation.other)} the other way"
    if isinstance(operation, Transform):
        x, y, z = (float(np.round(angle, 1)) for angle in axes.T @ np.array(operation.rotate))
        asked = replace(operation, translate=seen(operation.translate), rotate=(x, y, z), unit="size", axes="camera")
        return describe(asked)
    way = steps_in_words(seen(operation.offset))
    later = operation.time_shift
    parts = [f"ends {way} of it"] if way else []
    parts += [
        f"plays {abs(later):g} frames ({abs(later) / scene.fps:.1f} s) {'later' if later > 0 else 'earlier'}"
    ] * bool(later)
    copies = "the copy" if operation.count == 1 else f"each of the {operation.count} copies, seen from the one before,"
    named = f", called {operation.name}" if operation.name else ""
    return f"copy {whom_with(operation)}{named}: {copies} {' and '.join(parts) or 'is in the same place'}"
