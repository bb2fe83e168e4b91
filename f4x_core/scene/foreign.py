"""Opening scenes and splats.

Splats of other programs become scenes in which nothing moves, or a sequence of them (`recognise.identify` tells what a file is).
Coordinates and unit stay the file's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..geometry.camera import CameraPath
from ..geometry.splats import Splats
from .file import read_scene
from .formats.gltf_splats import read_gltf
from .formats.splat import read_splat
from .formats.spz import read_spz
from .model import PosedSplats, Scene, StaticSet
from .placing import offset_for
from .ply import read_ply_activation
from .recognise import identify, numbered_files, prefix, siblings

WIDTH, HEIGHT, FIELD_OF_VIEW = 960, 540, 50.0
"""Pixels and vertical degrees of the camera that frames splats which come without one."""
SEEN = 0.1
"""Opacity from which a Gaussian counts when the camera is placed; floaters are fainter."""
INNER = (5, 95)
"""Percentiles of the positions that the camera frames: splat files have far outliers."""
SEQUENCE_FPS = 30.0
"""Files do not tell theirs."""
READERS = {"splat": read_splat, "spz": read_spz, "gltf": read_gltf}
"""Kind -> reader of a single file of splats; PLY files have notes besides."""


@dataclass(frozen=True, eq=False)
class SplatSequence:
    """Splat files that follow one another in time, each read when it is needed. Exports take it like a scene."""

    name: str
    """The common part of the file names."""
    paths: tuple[Path, ...]
    """3DGS PLY files, in order of their numbers; clip time i is file i."""
    fps: float = SEQUENCE_FPS
    """Frames per second."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on how it was read."""
        named = f"{self.paths[0].name} to {self.paths[-1].name}"
        return (
            f"{len(self.paths)} numbered files ({named}) were taken for the moments of an animation",
            *notes_of(self[0]),
        )

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Scene:
        """Return the scene of one frame, in which nothing moves. Raises F4xError that names the file."""
        return _read_ply_scene(self.paths[index], self.name, None if index == 0 else self.offset)

    @cached_property
    def offset(self) -> np.ndarray:
        """(3,) float64 that was taken off all positions: that of the first file."""
        return self[0].offset

    @cached_property
    def cameras(self) -> CameraPath:
        """Standing camera that frames the first file, the same for every frame."""
        camera = self[0].cameras
        return CameraPath(
            np.repeat(camera.intrinsics, len(self), axis=0),
            np.repeat(camera.world_to_camera, len(self), axis=0),
            np.arange(len(self)),
            camera.width,
            camera.height,
        )

    @property
    def scaffold(self) -> None:
        """None: motion between the files is not known."""

    def posed(self, time: float) -> PosedSplats:
        """Return the splats of the file nearest to clip time `time`."""
        return self._frame(int(np.clip(round(time), 0, len(self) - 1)))

    @cached_property
    def _frame(self) -> Callable[[int], PosedSplats]:
        return lru_cache(maxsize=1)(lambda index: self[index].posed(0.0))


def open_any(path: Path | str, sequence: bool = True) -> Scene | SplatSequence:
    """Open a `.f4x` scene, splats (3DGS PLY, `.splat`, `.spz`, glTF) or a numbered PLY sequence (its folder or a file of it).

    A single splat file becomes a scene in which nothing moves, with one camera that frames it. With `sequence` False
    a numbered file is opened alone. Raises F4xError that says what the file is and what to do with it.
    """
    path = Path(path)
    kind = identify(path, sequence)
    if kind == "scene":
        return read_scene(path)
    if kind == "sequence":
        paths = numbered_files(path) if path.is_dir() else siblings(path)
        return SplatSequence(prefix(paths[0]) or paths[0].absolute().parent.name, tuple(paths))
    if kind == "ply":
        return _read_ply_scene(path, path.stem)
    return scene_of(READERS[kind](path), path.stem, path)


def scene_of(
    splats: Splats, name: str, source: Path, notes: tuple[str, ...] = (), offset: np.ndarray | None = None
) -> Scene:
    """Return a scene in which nothing moves, with one camera that frames the splats; F4xError names `source`.

    Positions that float32 cannot hold are brought near the origin by `offset (3,)`, by default the one that suits them.
    `notes` are what a person must know of how the file was read (`notes_of`).
    """
    try:
        offset = offset_for(splats.means, splats.scales) if offset is None else offset
        imported: dict[str, Any] = {"file": source.name}
        if offset.any():
            shift = ", ".join(f"{value:,.0f}" for value in offset)
            notes += (
                f"its positions lie about ({shift}) from the origin; the scene is kept near it, the offset in float64",
            )
            imported["offset"] = offset.tolist()
        if notes:
            imported["notes"] = list(notes)
        with np.errstate(over="ignore"):  # refused below
            splats = replace(splats, means=(splats.means - offset if offset.any() else splats.means).astype(np.float32))
        return Scene(
            name=name,
            static=StaticSet(ids=np.arange(len(splats)), **splats.arrays()),
            cameras=_framing(splats),
            provenance={"import": imported},
        )
    except F4xError as error:
        raise F4xError(f"{source}: {error}") from error


def notes_of(opened: Scene | SplatSequence) -> tuple[str, ...]:
    """Return the notes for the user on how splats of other programs were read, in sentences without a full stop."""
    if isinstance(opened, SplatSequence):
        return opened.notes
    return tuple(opened.provenance.get("import", {}).get("notes", ()))


def _read_ply_scene(path: Path, name: str, offset: np.ndarray | None = None) -> Scene:
    splats, activation = read_ply_activation(path)
    return scene_of(splats, name, path, activation.notes, offset)


def _framing(splats: Splats) -> CameraPath:
    """Return the path of one camera, which looks along z at all visible splats."""
    if not np.isfinite(splats.means).all():
        raise F4xError("some positions are infinite, or beyond what float32 holds; clean it in a splat editor")
    seen = splats.opacities >= SEEN
    means = splats.means[seen] if seen.any() else splats.means
    low, high = np.percentile(means, INNER, axis=0) if len(means) else (np.zeros(3), np.zeros(3))
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    half = np.radians(FIELD_OF_VIEW / 2)
    focal = HEIGHT / 2 / np.tan(half)
    matrix = np.eye(4)
    matrix[:3, 3] = -(low + high) / 2 + [0, 0, radius / np.sin(half)]
    intrinsics = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return CameraPath(intrinsics[None], matrix[None], np.zeros(1), WIDTH, HEIGHT)
