"""Lines that are drawn over a viewport while a gesture is made."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import gpu
from gpu_extras.batch import batch_for_shader

COLOUR = (1.0, 0.6, 0.1, 1.0)


class Outline:
    """Closed lines over one region, drawn until `end`."""

    def __init__(self, region: bpy.types.Region):
        self.lines: list[Sequence[tuple[float, float]]] = []
        """Corners of each line, pixels of the region from its lower left corner."""
        self._region = region
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")

    def end(self) -> None:
        """Draw no longer."""
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")

    def _draw(self) -> None:
        if bpy.context.region != self._region:
            return
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        shader.uniform_float("color", COLOUR)
        for line in self.lines:
            if len(line) > 1:
                batch_for_shader(shader, "LINE_STRIP", {"pos": [*line, line[0]]}).draw(shader)
