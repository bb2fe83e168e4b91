"""The scene that a fit has written, in figures: for the terminal, for `--json` and for who called it from Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..scene import Scene


@dataclass(frozen=True)
class FittedScene:
    """A scene file that a fit wrote, of a whole clip or of one shot of a long one."""

    path: Path
    """The scene file; its page `diagnostics.html` and `metrics.json` lie beside it."""
    frames: tuple[int, int]
    """First frame and end, counted in the frames of the clip that are used."""
    picked: str
    """Frames in the source, as `--frames` writes them."""
    size: tuple[int, int]
    """Width and height of its pictures."""
    windows: int
    """Windows that it was joined from; 0: it was fitted at once."""
    static: int
    """Gaussians of the background."""
    dynamic: int
    """Gaussians that move."""
    nodes: int
    """Nodes that carry them."""
    metrics: Mapping[str, Any]
    """The content of `metrics.json` without single frames."""
    needs: tuple[Mapping[str, str], ...]
    """Rows of the needs table."""

    @classmethod
    def of(
        cls, path: Path, scene: Scene, metrics: Mapping[str, Any], frames: tuple[int, int], windows: int = 0
    ) -> FittedScene:
        """Return the `scene` that was written to `path`."""
        size = scene.cameras.width, scene.cameras.height
        nodes = 0 if scene.scaffold is None else len(scene.scaffold)
        counts = len(scene.static), len(scene.dynamic), nodes
        return cls(path, frames, scene.provenance.get("frames", ""), size, windows, *counts, metrics, scene.needs)

    def __len__(self) -> int:
        return self.frames[1] - self.frames[0]

    @property
    def page(self) -> Path:
        """The diagnostics page."""
        return self.path.with_name("diagnostics.html")

    def to_json(self) -> dict[str, Any]:
        """Return the fields that `--json` prints for a shot of a long clip."""
        return {
            "scene": str(self.path),
            "frames": list(self.frames),
            "picked": self.picked,
            "windows": self.windows,
            "metrics": self.metrics,
            "needs": list(self.needs),
            "static": self.static,
            "dynamic": self.dynamic,
            "nodes": self.nodes,
        }
