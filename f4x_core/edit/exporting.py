"""Exporting in a process of its own, with edits that no file holds yet (`scene_task`)."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..language.lexicon import plural
from ..progress import Progress
from ..scene.formats import export
from .scene_task import SceneTask


@dataclass(frozen=True)
class ExportTask(SceneTask):
    """Contents of an export."""

    times: list[float]
    """Clip times."""
    output: str
    """Path of a file, or of the folder of many."""
    format: str
    """Name of an entry of `FORMATS`."""
    transform: list[float] | None = None
    """4x4 similarity in the scene's axes, row by row, that is baked in."""

    def carry_out(self, progress: Progress) -> tuple[dict[str, Any], str]:
        """Write the files."""
        scene = self.opened(progress)
        transform = None if self.transform is None else np.reshape(self.transform, (4, 4))
        done = export(scene, Path(self.output), self.times, self.format, transform, progress)
        count = len(done.files)
        text = self.output if count == 1 else f"{self.output}: {count} {plural('file', count)}"
        return {"output": self.output, "files": count}, "; ".join([text, *done.notes])


if __name__ == "__main__":
    sys.exit(ExportTask.main(sys.argv[1:]))
