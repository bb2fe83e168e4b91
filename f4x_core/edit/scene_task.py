"""A task on a scene as Blender shows it, for a process of its own: `python -m MODULE TASK.json`, whose module ends in `main`.

The process needs numpy alone, so Blender's own Python runs it. It writes JSON lines as the verbs of `f4x` do with
`--progress-json` (`processes`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ..errors import F4xError
from ..processes import LineProgress, serve
from ..progress import Progress
from ..scene import Scene
from .apply import open_with


@dataclass(frozen=True)
class SceneTask:
    """Base of the tasks, one in a module. All fields are values of JSON."""

    scene: str
    """Path of a scene or splat file."""
    edits: str
    """JSON of the stack in place of its own."""

    def write(self, path: Path) -> None:
        """Write it for the process."""
        path.write_text(json.dumps(vars(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what `write` wrote."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))

    @classmethod
    def module(cls) -> str:
        """Return the module that carries it out, without the name of the core's package, which is longer inside Blender."""
        return cls.__module__.rpartition("f4x_core.")[2]

    def opened(self, progress: Progress) -> Scene:
        """Open the scene with its edits. F4xError that names the file."""
        progress("scene", 0, 1)
        return open_with(Path(self.scene), self.edits)

    def carry_out(self, progress: Progress) -> tuple[dict[str, Any], str]:
        """Carry out the task. Return the result and a sentence about it. Raises F4xError where that is impossible."""
        raise NotImplementedError

    @classmethod
    def main(cls, arguments: list[str]) -> int:
        """Carry out the task that the only argument names, and report the progress; returns the exit code."""

        def work(progress: LineProgress) -> tuple[dict[str, Any], str]:
            if len(arguments) != 1:
                raise F4xError("name one file: TASK.json")
            return cls.read(Path(arguments[0])).carry_out(progress)

        return serve(work)
