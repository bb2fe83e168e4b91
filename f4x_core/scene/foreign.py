"""Opening whatever a person points at: recognised by the content of the file, not by its name.

Splats of other programs become scenes in which nothing moves, or a sequence of them. Whatever else it is, the answer
is one sentence that says so and what to do with it. Coordinates and unit stay the file's own.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..clip.images import list_images, natural_key
from ..errors import F4xError
from ..geometry.camera import CameraPath
from ..geometry.splats import Splats
from .file import HEADER, read_scene
from .formats.gltf_splats import holds_splats, read_gltf
from .formats.splat import looks_like_splat, read_splat
from .formats.spz import read_spz
from .model import PosedSplats, Scene, StaticSet
from .placing import offset_for
from .ply import read_ply_activation

Kind = Literal["scene", "ply", "splat", "spz", "gltf", "sequence"]
WIDTH, HEIGHT, FIELD_OF_VIEW = 960, 540, 50.0
"""Pixels and vertical degrees of the camera that frames splats which come without one."""
SEEN = 0.1
"""Opacity from which a Gaussian counts when the camera is placed; floaters are fainter."""
INNER = (5, 95)
"""Percentiles of the positions that the camera frames: splat files have far outliers."""
SEQUENCE_FPS = 30.0
"""Files do not tell theirs."""
NUMBERED = re.compile(r"(.*?)(\d+)\.ply", re.IGNORECASE)
PADDED = 3
"""Digits from which one numbered file stands for its sequence; `chair2.ply` is a file of its own."""
PROBE = 4096
"""Bytes at the start that signatures look at."""
CONVERT = "convert it to a 3DGS PLY with a splat editor first"
FIT = "make a scene of it with `f4x fit {path} -o DIR`"
GZIP = b"\x1f\x8b"
SIGNATURES = (
    (0, b"NGSP", f"SPZ splats of version 4, of which 2 and 3 can be read; {CONVERT}"),
    (0, b"glTF", "a glTF binary without splats; import it in Blender, or take the splats' PLY"),
    (0, b"#usda", "a USD stage; import it in Blender, or take the splats' PLY"),
    (0, b"PXR-USDC", "a USD stage; import it in Blender, or take the splats' PLY"),
    (0, b"BLENDER", "a Blender file; open it in Blender"),
    (0, b"\x28\xb5\x2f\xfd", "a Zstandard file (compressed .blend files are such); open it in Blender"),
    (4, b"ftyp", f"a video; {FIT}"),
    (0, b"\x1a\x45\xdf\xa3", f"a video; {FIT}"),
    (8, b"AVI ", f"a video; {FIT}"),
    (0, b"\x00\x00\x01\xba", f"a video; {FIT}"),
    (0, b"OggS", f"a video; {FIT}"),
    (0, b"\x89PNG", "one picture; give `f4x fit` a video or a folder of frames"),
    (0, b"\xff\xd8\xff", "one picture; give `f4x fit` a video or a folder of frames"),
    (0, b"GIF8", "one picture; give `f4x fit` a video or a folder of frames"),
    (8, b"WEBP", "one picture; give `f4x fit` a video or a folder of frames"),
    (0, b"v/1\x01", "an OpenEXR picture; give `f4x fit` a video or a folder of frames"),
    (0, b"solid ", "an STL mesh; import it in Blender"),
    (0, b"{", "a JSON file; choose a .f4x scene or a splat file"),
)
"""(offset, bytes there, what the file is and what to do)."""
BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")
"""Bytes that no text has; the first byte of a .splat can be that of any text."""
READERS = {"splat": read_splat, "spz": read_spz, "gltf": read_gltf}
"""Of one file of splats, by kind; PLY files have notes besides."""
MAX_STEP = 100
"""Between the numbers of neighbouring moments; checkpoints of a trainer lie hundreds of steps apart."""


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
        """The scene of one frame, in which nothing moves. Raises F4xError that names the file."""
        return _read_ply_scene(self.paths[index], self.name, None if index == 0 else self.offset)

    @cached_property
    def offset(self) -> np.ndarray:
        """(3,) float64 that was taken off all positions: that of the first file."""
        return self[0].offset

    @cached_property
    def cameras(self) -> CameraPath:
        """The same standing camera for every frame; it frames the first."""
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
        """None: what moves between the files is not known."""

    def posed(self, time: float) -> PosedSplats:
        """The splats of the file nearest to clip time `time`."""
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
        paths = _numbered_files(path) if path.is_dir() else _siblings(path)
        return SplatSequence(_prefix(paths[0]) or paths[0].absolute().parent.name, tuple(paths))
    if kind == "ply":
        return _read_ply_scene(path, path.stem)
    return scene_of(READERS[kind](path), path.stem, path)


def identify(path: Path | str, sequence: bool = True) -> Kind:
    """Identify by content what `open_any` would open. Raises F4xError for everything else, in one sentence."""
    path = Path(path)
    try:
        if path.is_dir():
            return _identify_folder(path)
        if path.exists() and not path.is_file():  # opening a pipe would wait for ever
            raise F4xError(f"{path}: no ordinary file; choose a .f4x scene or a splat file")
        with path.open("rb") as file:
            start = file.read(PROBE)
        if not start:
            raise F4xError(f"{path}: empty, so not a whole scene or splat file; copy or export it again")
        if start[:4] == b"PK\x03\x04":
            return _identify_zip(path)
        if re.match(rb"ply\r?\n", start):
            siblings = _siblings(path) if sequence else []
            return "sequence" if len(siblings) > 1 and _uneven(siblings) is None else "ply"
        if start.startswith(GZIP):
            return "spz"  # `read_spz` says if it is something else
        text = start.removeprefix(b"\xef\xbb\xbf").lstrip()
        if (start.startswith(b"glTF") or text.startswith(b"{")) and holds_splats(path):
            return "gltf"
        for offset, signature, sentence in SIGNATURES:
            if start.startswith(signature, offset) and (signature != b"{" or not BINARY.search(start)):
                raise F4xError(f"{path}: {sentence.format(path=path)}")
        if looks_like_splat(path):
            return "splat"
    except FileNotFoundError as error:
        raise F4xError(f"{path}: there is no such file; choose a .f4x scene or a splat file") from error
    except OSError as error:
        raise F4xError(
            f"{path}: cannot be read ({error.strerror or error}); choose a .f4x scene or a splat file"
        ) from error
    raise F4xError(
        f"{path}: neither a scene nor splats that are known here; choose a .f4x, a 3DGS .ply, a .splat, a .spz or a .glb file"
    )


def scene_of(
    splats: Splats, name: str, source: Path, notes: tuple[str, ...] = (), offset: np.ndarray | None = None
) -> Scene:
    """A scene in which nothing moves, with one camera that frames the splats; F4xError names `source`.

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
            cameras=CameraPath(*_framing(splats), WIDTH, HEIGHT),
            provenance={"import": imported},
        )
    except F4xError as error:
        raise F4xError(f"{source}: {error}") from error


def notes_of(opened: Scene | SplatSequence) -> tuple[str, ...]:
    """Notes for the user on how splats of other programs were read, in sentences without a full stop."""
    if isinstance(opened, SplatSequence):
        return opened.notes
    return tuple(opened.provenance.get("import", {}).get("notes", ()))


def _read_ply_scene(path: Path, name: str, offset: np.ndarray | None = None) -> Scene:
    splats, activation = read_ply_activation(path)
    return scene_of(splats, name, path, activation.notes, offset)


def _framing(splats: Splats) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intrinsics (1,3,3), world_to_camera (1,4,4) and times (1,) of a camera that looks along z at all that is seen."""
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
    return np.array([[[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]]]), matrix[None], np.zeros(1)


def _identify_zip(path: Path) -> Kind:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, UnicodeDecodeError):
        return "scene"  # `read_scene` says what is broken
    if HEADER in names:
        return "scene"
    if "meta.json" in names:
        raise F4xError(f"{path}: SOG splats; {CONVERT}")
    if any(Path(name).suffix.lower() in (".usd", ".usda", ".usdc") for name in names[:1]):
        raise F4xError(f"{path}: a USD package; import it in Blender, or take the splats' PLY")
    images = sum(Path(name).suffix.lower() in (".png", ".jpg", ".jpeg") for name in names)
    if images > 1:
        raise F4xError(
            f"{path}: a zip of pictures; unpack it and make a scene of the folder with `f4x fit FOLDER -o DIR`"
        )
    raise F4xError(f"{path}: a zip without {HEADER}, so not a Feature4X scene; choose a .f4x file")


def _identify_folder(folder: Path) -> Kind:
    numbered = _numbered_files(folder)
    if numbered:
        uneven = _uneven(numbered)
        if uneven is not None:
            raise F4xError(f"{folder}: {uneven}; choose one file, the last is {numbered[-1].name}")
        return "sequence"
    if (folder / "scene.f4x").is_file():
        raise F4xError(f"{folder}: the folder of a fit; choose {folder / 'scene.f4x'}")
    for images_folder in (folder, folder / "images", folder / "rgb", folder / "JPEGImages"):
        if list_images(images_folder) or (images_folder != folder and images_folder.is_dir()):
            raise F4xError(f"{folder}: a folder of pictures; {FIT.format(path=folder)}")
    raise F4xError(f"{folder}: a folder without numbered .ply files; choose a scene, a splat file or a PLY sequence")


def _numbered_files(folder: Path) -> list[Path]:
    """The PLY files `NAME_0001.ply, …` of a folder in order; F4xError where they have several names."""
    files = [file for file in folder.iterdir() if NUMBERED.fullmatch(file.name) and not file.name.startswith(".")]
    files.sort(key=lambda file: natural_key(file.name))
    prefixes = {_prefix(file) for file in files}
    if len(prefixes) > 1:
        raise F4xError(
            f"{folder}: PLY files of {len(prefixes)} sequences ({', '.join(sorted(prefixes)[:4])}, …); choose one file"
        )
    return files


def _siblings(file: Path) -> list[Path]:
    """The sequence that a numbered file belongs to, itself too; empty when its name has no padded number."""
    match = NUMBERED.fullmatch(file.name)
    if match is None or len(match[2]) < PADDED:
        return []
    found = [other for other in file.parent.iterdir() if (m := NUMBERED.fullmatch(other.name)) and m[1] == match[1]]
    return sorted(found, key=lambda other: natural_key(other.name))


def _uneven(files: list[Path]) -> str | None:
    """Why numbered files are no moments of an animation; None where their numbers are evenly spaced."""
    numbers = [int(match[2]) for file in files if (match := NUMBERED.fullmatch(file.name))]
    steps = {after - before for before, after in pairwise(numbers)}
    if len(steps) <= 1 and all(0 < step <= MAX_STEP for step in steps):
        return None
    listed = ", ".join(map(str, numbers[:4])) + (", …" if len(numbers) > 4 else "")
    return f"its PLY files are numbered {listed}, not evenly or by more than {MAX_STEP}, so no moments of an animation"


def _prefix(file: Path) -> str:
    match = NUMBERED.fullmatch(file.name)
    return match[1].rstrip("_-. ") if match else file.stem
