"""Formats of other programs that a scene can be written in (docs/formats.md)."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import F4xError
from ...progress import Progress, silent
from ..ply import export_frame
from ..posing import Posable
from .gltf import write_gltf
from .points import write_points
from .splat import write_splat
from .spz import write_spz
from .usd import write_usd, write_usd_points

WriteFrame = Callable[[Posable, float, Path, np.ndarray | None], tuple[str, ...] | None]
"""Returns what a person must know of the file, in sentences without a full stop."""
WriteClip = Callable[[Posable, Sequence[float], Path, np.ndarray | None, Progress], None]


@dataclass(frozen=True)
class Format:
    """Writer of one export format."""

    suffixes: tuple[str, ...]
    """Suffixes of its files; a folder of frames gets the first."""
    keeps: str
    """Contents that a reader gets back, in a few words."""
    write_frame: WriteFrame | None = None
    """Writes one moment; many moments are a folder of numbered files."""
    write_clip: WriteClip | None = None
    """Writes many moments into one file."""
    doubles: bool = True
    """True where positions, or their common transform, have double precision: then the offset of a far scene is in the file."""


@dataclass(frozen=True)
class Exported:
    """Files that an export wrote, and notes for the user."""

    files: list[Path]
    notes: tuple[str, ...] = ()
    """Notes for the user, in sentences without a full stop."""


FORMATS = {
    "ply": Format((".ply",), "Gaussians with all harmonics, one moment a file", write_frame=export_frame),
    "splat": Format(
        (".splat",), "Gaussians with one color in 8 bits, one moment a file", write_frame=write_splat, doubles=False
    ),
    "spz": Format(
        (".spz",), "Gaussians with all harmonics in 8 bits, one moment a file", write_frame=write_spz, doubles=False
    ),
    "gltf": Format(
        (".glb", ".gltf"), "Gaussians with harmonics to degree 3, one moment a file", write_frame=write_gltf
    ),
    "usd": Format(
        (".usda", ".usdc"), "Gaussians with harmonics to degree 3, all moments in one file", write_clip=write_usd
    ),
    "points": Format(
        (".glb",), "colored points and the scaffold, one moment a file", write_frame=write_points, doubles=False
    ),
    "usd-points": Format((".usda",), "colored points, all moments in one file", write_clip=write_usd_points),
}
"""Name -> format; where two share a suffix, the first is meant by the suffix alone."""
DEFAULT = "ply"
"""Format of a folder of frames unless another is named."""


def choose_format(output: Path | str, name: str | None = None, one_moment: bool = False) -> tuple[str, bool]:
    """Return (name of the format, whether `output` is a file and not a folder of numbered files).

    Without a `name` the suffix of `output` tells. Raises F4xError for an unknown format and for a file or folder that
    does not go with the number of moments.
    """
    output = Path(output)
    suffix = output.suffix.lower()
    known = {suffix: name for name, format in reversed(FORMATS.items()) for suffix in format.suffixes}
    if name is None and re.fullmatch(r"\.[a-z]\w*", suffix) and suffix not in known and not output.is_dir():
        raise F4xError(
            f"-o {output}: there is no export to {suffix}; end it in {', '.join(sorted(known))}, or give a folder."
        )
    name = known.get(suffix, DEFAULT) if name is None else name
    if name not in FORMATS:
        raise F4xError(f"there is no export format '{name}'; choose from {', '.join(FORMATS)}.")
    suffixes = FORMATS[name].suffixes
    is_file = suffix in suffixes
    if FORMATS[name].write_clip is not None and not is_file:
        raise F4xError(f"-o {output}: {name} holds all frames in one file; give FILE{suffixes[0]}.")
    if FORMATS[name].write_frame is not None and is_file != one_moment:
        raise F4xError(f"-o {output}: give FILE{suffixes[0]} together with --time T, and a folder for all frames.")
    return name, is_file


def export(
    scene: Posable,
    output: Path | str,
    times: Sequence[float],
    name: str = DEFAULT,
    transform: np.ndarray | None = None,
    progress: Progress = silent,
) -> Exported:
    """Write `scene` at the clip `times` in the format `name` and return the files, with what a person must know of them.

    `output` is a file where it ends as the format's files do, else a folder that gets `NAME_0000.ply, NAME_0001.ply, …`:
    what sequence readers and splat editors recognise. The numbers are the clip frames, or count from 0 where a time lies
    between two frames. Folders are made if absent.
    `transform`: 4x4 similarity in the scene's axes, baked in before a far scene's offset is added. Raises F4xError; no file is
    left half-written.
    """
    output, format = Path(output), FORMATS[name]
    is_file = output.suffix.lower() in format.suffixes
    if is_file and format.write_clip is None and len(times) != 1:
        raise F4xError(f"{output}: {name} holds one moment a file; give a folder for {len(times)} moments.")
    notes = _offset_notes(scene.offset, format)
    _make_folder(output.parent if is_file else output)
    if format.write_clip is not None:
        format.write_clip(scene, times, output, transform, progress)
        return Exported([output], notes)
    assert format.write_frame is not None
    paths = [output] if is_file else _numbered(output, scene.name, format.suffixes[0], times)
    for done, (time, path) in enumerate(zip(times, paths, strict=True)):
        progress("export", done, len(times), path.name)
        notes += format.write_frame(scene, time, path, transform) or ()
    progress("export", len(times), len(times))
    return Exported(paths, tuple(dict.fromkeys(notes)))


def _offset_notes(offset: np.ndarray, format: Format) -> tuple[str, ...]:
    """Return True where the offset (3,) of a far scene is in its files."""
    if not offset.any():
        return ()
    shift = ", ".join(f"{value:,.0f}" for value in offset)
    if format.doubles:
        return (f"the offset ({shift}) of the file it came from is in there again, in double precision",)
    return (f"its format has no double precision, so positions are near the origin: add ({shift}), or export PLY",)


def _numbered(folder: Path, name: str, suffix: str, times: Sequence[float]) -> list[Path]:
    """Return paths in `folder`, one for each of `times`."""
    whole = all(float(time).is_integer() and time >= 0 for time in times)
    numbers = [int(time) for time in times] if whole else list(range(len(times)))
    prefix = re.sub(r"[^\w-]+", "_", name).strip("_") or "scene"
    digits = max(4, len(str(max(numbers, default=0))))
    return [folder / f"{prefix}_{number:0{digits}d}{suffix}" for number in numbers]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise F4xError(f"{folder}: this folder cannot be made ({error.strerror}); choose another one") from error
