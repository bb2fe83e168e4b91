"""A scene, or splats of another program, in a format of other programs: one moment or many."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ..clip.read import frame_indices
from ..edit.apply import open_scene
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.foreign import SplatSequence, notes_of, open_any
from ..scene.formats import choose_format, export
from ..scene.posing import require_time
from ..scene.recognise import identify


@dataclass(frozen=True)
class ExportOptions:
    """The format and the moments of the clip; `f4x export --help` has the same options."""

    format: str | None = None
    """Name of an entry of `scene.formats.FORMATS`; None: by the ending of the output."""
    time: float | None = None
    """Clip frame, from 0, which may lie between two; None: many."""
    frames: str | None = None
    """First frame, end and step of many as `A:B:S`; None: all."""

    def format_of(self, output: Path | str) -> str:
        """Return the name of the format of `output`. Raises F4xError where it does not go with the moments."""
        return choose_format(output, self.format, one_moment=self.time is not None)[0]

    def times_of(self, scene: Scene | SplatSequence, name: Path | str) -> list[float]:
        """Return the clip times of the moments. Raises F4xError, about the scene called `name`, for moments that it lacks."""
        if self.time is not None:
            require_time(scene, self.time, f"--time {self.time:g}")
            return [float(self.time)]
        times: list[float] = scene.cameras.times[frame_indices(self.frames, len(scene.cameras), name)].tolist()
        return times


@dataclass(frozen=True)
class ExportedFiles:
    """Files that an export wrote."""

    output: Path
    """The file, or the folder of numbered files."""
    format: str
    """Name of the format."""
    moments: int
    """Number of clip times."""
    files: tuple[Path, ...]
    """All files."""
    notes: tuple[str, ...]
    """Sentences for people, without a full stop: what the format cannot hold, what was guessed of the source."""


def export_file(
    source: Path, output: Path, options: ExportOptions, edits: bool = True, progress: Progress = silent
) -> ExportedFiles:
    """Write the scene or splats at `source` for other programs, as `f4x export` does; `edits` False leaves its edits out."""
    options.format_of(output)  # refused before the source is read
    is_scene = identify(source) == "scene"
    scene = open_scene(source, edits) if is_scene else open_any(source)
    done = export_scene(scene, source, output, options, progress)
    return done if is_scene else replace(done, notes=(*notes_of(scene), *done.notes))


def export_scene(
    scene: Scene | SplatSequence, source: Path, output: Path, options: ExportOptions, progress: Progress = silent
) -> ExportedFiles:
    """Write an open scene or splats, read from `source`, for other programs."""
    format, times = options.format_of(output), options.times_of(scene, source)
    done = export(scene, output, times, format, progress=progress)
    return ExportedFiles(output, format, len(times), tuple(done.files), tuple(done.notes))
