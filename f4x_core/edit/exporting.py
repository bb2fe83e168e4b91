"""Exporting in a process of its own that needs numpy alone: Blender's Python runs it, with edits that no file holds yet."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from ..errors import F4xError
from ..language.lexicon import plural
from ..processes import LineProgress, serve
from ..scene.formats import Exported, export
from .apply import open_with
from .stack import EditStack


@dataclass(frozen=True)
class ExportRequest:
    """What is exported."""

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

    def write(self, path: Path) -> None:
        """Write it for the child."""
        fields = {"scene": str(self.scene), "output": str(self.output), "times": list(self.times)}
        path.write_text(json.dumps(fields | {"edits": self.edits, "format": self.format}), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> ExportRequest:
        """Read what `write` wrote."""
        fields = json.loads(path.read_text(encoding="utf-8"))
        times = tuple(fields["times"])
        return cls(Path(fields["scene"]), fields["edits"], times, Path(fields["output"]), fields["format"])

    def export(self, progress: LineProgress) -> Exported:
        """Write the files."""
        progress("scene", 0, 1)
        scene = open_with(self.scene, EditStack.from_json(json.loads(self.edits), str(self.scene)))
        return export(scene, self.output, self.times, self.format, progress=progress)


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
