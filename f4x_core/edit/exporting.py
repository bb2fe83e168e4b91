"""Exporting in a process of its own that needs numpy alone: Blender's Python runs it, with edits that no file holds yet."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..language.lexicon import plural
from ..processes import LineProgress, serve
from ..scene.formats import Exported, export
from .apply import open_with


@dataclass(frozen=True)
class ExportRequest:
    """Contents of an export."""

    scene: Path
    """A scene or splat file."""
    edits: str
    """JSON of the stack in place of its own."""
    times: tuple[float, ...]
    """Clip times."""
    output: Path
    """A file, or the folder of many."""
    format: str
    """Name of an entry of `FORMATS`."""
    transform: tuple[float, ...] | None = None
    """4x4 similarity in the scene's axes, row by row, that is baked in."""

    def write(self, path: Path) -> None:
        """Write it for the child."""
        fields: dict[str, Any] = {"scene": str(self.scene), "output": str(self.output), "times": list(self.times)}
        fields |= {"edits": self.edits, "format": self.format, "transform": self.transform}
        path.write_text(json.dumps(fields), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> ExportRequest:
        """Read what `write` wrote."""
        fields = json.loads(path.read_text(encoding="utf-8"))
        paths = {name: Path(fields[name]) for name in ("scene", "output")}
        return cls(**fields | paths | {"times": tuple(fields["times"])})

    def export(self, progress: LineProgress) -> Exported:
        """Write the files."""
        progress("scene", 0, 1)
        scene = open_with(self.scene, self.edits)
        transform = None if self.transform is None else np.reshape(self.transform, (4, 4))
        return export(scene, self.output, self.times, self.format, transform, progress)


def main(arguments: list[str]) -> int:
    """Carry out a request, and report the progress."""

    def work(progress: LineProgress) -> tuple[dict, str]:
        if len(arguments) != 1:
            raise F4xError("name one file: python -m f4x_core.edit.exporting REQUEST.json")
        request = ExportRequest.read(Path(arguments[0]))
        done = request.export(progress)
        count = len(done.files)
        text = str(request.output) if count == 1 else f"{request.output}: {count} {plural('file', count)}"
        return {"output": str(request.output), "files": count}, "; ".join([text, *done.notes])

    return serve(work)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
