"""The mesh of a selection, made for Blender in a process of its own (`scene_task`)."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..language.lexicon import plural
from ..progress import Progress
from ..scene import Scene
from ..scene.mesh import MeshConfig, NoNodeError, SplatMesh, mesh_of
from .bake import bake, unfolded
from .scene_task import SceneTask


@dataclass(frozen=True)
class MeshTask(SceneTask):
    """Sources of a mesh."""

    ids: list[int]
    """Ids of the selected Gaussians."""
    time: float | None
    """Clip time at which the surface is found; None: where they are spread the widest."""
    config: dict[str, Any]
    """Fields of `MeshConfig`."""
    output: str
    """Path of the file that `SplatMesh.read` reads."""

    def made(self, progress: Progress) -> SplatMesh:
        """Make the mesh; see `mesh_of`."""
        scene = self.opened(progress)
        with advising(scene):
            return mesh_of(scene, np.isin(scene.ids, self.ids), self.time, MeshConfig(**self.config), progress)

    def carry_out(self, progress: Progress) -> tuple[dict[str, Any], str]:
        """Make the mesh and write it."""
        mesh = self.made(progress)
        mesh.write(Path(self.output))
        text = f"{len(mesh.faces):,} triangles in {mesh.parts} {plural('part', mesh.parts)}"
        return {"faces": len(mesh.faces), "parts": mesh.parts}, text


@contextmanager
def advising(scene: Scene) -> Iterator[None]:
    """Complete the error of a mesh whose Gaussians no node carries: bake the edits of `scene`, or do without those that stay."""
    try:
        yield
    except NoNodeError as error:
        left = ", ".join(sorted({edit.operation.TAG for edit in unfolded(bake(scene))}))
        advice = "`f4x bake` the scene and make the mesh of the new one"
        if left:
            advice = f"`f4x bake` would leave these edits as they are: {left}; take them back first (`f4x undo`)"
        raise F4xError(f"{error}; {advice}.") from error


if __name__ == "__main__":
    sys.exit(MeshTask.main(sys.argv[1:]))
