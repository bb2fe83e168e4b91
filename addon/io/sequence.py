"""A sequence of splat files: a point cloud for every frame, of which one is visible at a time.

No handler loads files during playback, so that renders, the .blend on another machine and undo behave; the price is memory,
which is why a sequence larger than `MAX_BYTES` is taken in steps.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ...f4x_core.errors import F4xError
from ...f4x_core.scene import Scene
from ...f4x_core.scene.foreign import SplatSequence
from ..common.animation import CONSTANT, write_action

MAX_BYTES = 4 << 30
"""Maximum total size of the files; a point cloud needs about as much memory as its file."""
HIDDEN = ("hide_viewport", "hide_render")


def check_size(sequence: SplatSequence, step: int) -> None:
    """Raise F4xError if the files are too large for memory; the message names a sufficient step."""
    size = sum(path.stat().st_size for path in sequence.paths[::step])
    if size > MAX_BYTES:
        enough = step * -(-size // MAX_BYTES)
        raise F4xError(
            f"{sequence.name}: its {len(sequence.paths[::step])} files hold {size / 2**30:.1f} GiB, which Blender would keep in"
            f" memory at once; import every {enough}th file (Step {enough})."
        )


def add_sequence(
    sequence: SplatSequence, step: int, name: str, add: Callable[[str, Scene], bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return a point cloud `NAME frame 00000` for every `step`th file, made by `add(name, scene)`, visible until the next one's."""
    clouds = []
    for first in range(0, len(sequence), step):
        cloud = add(f"{name} frame {first:05d}", sequence[first])
        after = first + step
        frames = np.array([frame for frame in (first - 1, first, after) if 0 <= frame < len(sequence)])
        hidden = np.array([float(not first <= frame < after) for frame in frames])
        write_action(cloud, frames, dict.fromkeys(HIDDEN, hidden), CONSTANT)
        clouds.append(cloud)
    return clouds
