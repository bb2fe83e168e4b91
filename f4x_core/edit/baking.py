"""A new scene file in which the edits of a scene are folded into its arrays; for Blender in a process of its own (`scene_task`)."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import F4xError
from ..files import same_file
from ..language.lexicon import plural
from ..progress import Progress
from ..scene import Scene, write_scene
from .bake import bake, unfolded
from .scene_task import SceneTask
from .stack import of


def bake_into(output: Path, scene: Scene, path: Path) -> dict[str, Any]:
    """Fold the edits of `scene`, which `path` holds, into the arrays of the new file `output`.

    Returns counts of edits and Gaussians, and `text`, a sentence about them. Raises F4xError without edits, and where `output`
    is `path`.
    """
    if same_file(output, path):
        raise F4xError(
            f"{output}: it is the scene itself, whose edits could not be undone any more; give another file."
        )
    if not scene.edits:
        raise F4xError(f"{path}: it has no edits to fold in; copy the file.")
    baked = bake(scene)
    write_scene(baked, output)
    left = unfolded(baked)
    names = len(of(baked)) - len(left)
    folded = len(baked.provenance.get("baked", ())) - len(scene.provenance.get("baked", ()))
    rest = ""
    if left:
        staying = [edit.operation.TAG for edit in left] + [f"{names} {plural('name', names)}"] * bool(names)
        rest = f"; these stay in the stack: {', '.join(staying)}: {_why_not_folded(scene)}"
    return {
        "output": str(output),
        "folded": folded,
        "left": len(left),
        "static": len(baked.static),
        "dynamic": len(baked.dynamic),
        "text": f"{output}: {folded} {plural('edit', folded)} folded in{rest}",
    }


def _why_not_folded(scene: Scene) -> str:
    """Return the reason why the first remaining edit cannot be folded in."""
    for number, edit in enumerate(of(scene).edits, 1):
        if edit.enabled and not edit.operation.lasts:
            return f"{edit.titled(number)} changes with time what base arrays hold once, and those after it build on it"
    return "the nodes of a scaffold cannot hold their moments exactly"


@dataclass(frozen=True)
class BakeTask(SceneTask):
    """Edits that are folded into a new scene file."""

    output: str
    """Path of the new file."""

    def carry_out(self, progress: Progress) -> tuple[dict[str, Any], str]:
        """Write the new file; see `bake_into`."""
        scene = self.opened(progress)
        progress("bake", 0, 1)
        result = bake_into(Path(self.output), scene, Path(self.scene))
        return result, result["text"]


if __name__ == "__main__":
    sys.exit(BakeTask.main(sys.argv[1:]))
