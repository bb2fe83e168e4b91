"""A child process that makes the mesh of a selection for Blender, whose own Python runs it: numpy alone.

python -m f4x_core.edit.meshing REQUEST.npz MADE.npz

It writes JSON lines as the verbs of `f4x` do with `--progress-json` (`processes`).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..language.lexicon import plural
from ..processes import LineProgress, serve
from ..progress import Progress
from ..scene import Scene
from ..scene.mesh import MeshConfig, NoNodeError, SplatMesh, mesh_of
from .apply import open_with
from .bake import bake, unfolded


@dataclass(frozen=True, eq=False)
class Request:
    """Sources of a mesh."""

    scene: Path
    """The scene file."""
    edits: str
    """JSON of the stack in place of its own."""
    ids: np.ndarray
    """(n,) ids of the selected Gaussians."""
    time: float | None
    """Clip time at which the surface is found; None: where they are spread the widest."""
    config: MeshConfig

    def write(self, path: Path) -> None:
        """Write it for the child."""
        settings = {"scene": str(self.scene), "edits": self.edits, "time": self.time, "config": asdict(self.config)}
        np.savez(path, ids=self.ids, settings=json.dumps(settings))

    @classmethod
    def read(cls, path: Path) -> Request:
        """Read what `write` wrote."""
        with np.load(path) as arrays:
            settings = json.loads(str(arrays["settings"]))
            config = MeshConfig(**settings["config"])
            return cls(Path(settings["scene"]), settings["edits"], arrays["ids"], settings["time"], config)

    def made(self, progress: Progress) -> SplatMesh:
        """Make the mesh; see `mesh_of`."""
        progress("scene", 0, 1)
        scene = open_with(self.scene, self.edits)
        with advising(scene):
            return mesh_of(scene, np.isin(scene.ids, self.ids), self.time, self.config, progress)


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


def main(arguments: list[str]) -> int:
    """Make the mesh of a request, telling how far it is."""

    def work(progress: LineProgress) -> tuple[dict, str]:
        if len(arguments) != 2:
            raise F4xError("name two files: python -m f4x_core.edit.meshing REQUEST.npz MADE.npz")
        mesh = Request.read(Path(arguments[0])).made(progress)
        mesh.write(Path(arguments[1]))
        text = f"{len(mesh.faces):,} triangles in {mesh.parts} {plural('part', mesh.parts)}"
        return {"faces": len(mesh.faces), "parts": mesh.parts}, text

    return serve(work)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
