"""Recognition of files by their content, not by their name.

Whatever is neither a scene nor splats gets one sentence that says what it is and what to do with it.
"""

from __future__ import annotations

import re
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Literal

from ..clip.images import list_images, natural_key
from ..errors import F4xError
from .formats.gltf_splats import holds_splats
from .formats.splat import looks_like_splat

HEADER = "scene.json"
"""The file inside a scene file that says what it holds."""
Kind = Literal["scene", "ply", "splat", "spz", "gltf", "sequence"]
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
MAX_STEP = 100
"""Between the numbers of neighbouring moments; checkpoints of a trainer lie hundreds of steps apart."""


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
            moments = siblings(path) if sequence else []
            return "sequence" if len(moments) > 1 and _uneven(moments) is None else "ply"
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
    numbered = numbered_files(folder)
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


def numbered_files(folder: Path) -> list[Path]:
    """Return the PLY files `NAME_0001.ply, …` of a folder in order; F4xError where they have several names."""
    files = [file for file in folder.iterdir() if NUMBERED.fullmatch(file.name) and not file.name.startswith(".")]
    files.sort(key=lambda file: natural_key(file.name))
    prefixes = {prefix(file) for file in files}
    if len(prefixes) > 1:
        raise F4xError(
            f"{folder}: PLY files of {len(prefixes)} sequences ({', '.join(sorted(prefixes)[:4])}, …); choose one file"
        )
    return files


def siblings(file: Path) -> list[Path]:
    """Return the sequence that a numbered file belongs to, itself too; empty when its name has no padded number."""
    match = NUMBERED.fullmatch(file.name)
    if match is None or len(match[2]) < PADDED:
        return []
    found = [other for other in file.parent.iterdir() if (m := NUMBERED.fullmatch(other.name)) and m[1] == match[1]]
    return sorted(found, key=lambda other: natural_key(other.name))


def _uneven(files: list[Path]) -> str | None:
    """Return why numbered files are no moments of an animation; None if their numbers are evenly spaced."""
    numbers = [int(match[2]) for file in files if (match := NUMBERED.fullmatch(file.name))]
    steps = {after - before for before, after in pairwise(numbers)}
    if len(steps) <= 1 and all(0 < step <= MAX_STEP for step in steps):
        return None
    listed = ", ".join(map(str, numbers[:4])) + (", …" if len(numbers) > 4 else "")
    return f"its PLY files are numbered {listed}, not evenly or by more than {MAX_STEP}, so no moments of an animation"


def prefix(file: Path) -> str:
    """Return the name of a numbered file without its number."""
    match = NUMBERED.fullmatch(file.name)
    return match[1].rstrip("_-. ") if match else file.stem
