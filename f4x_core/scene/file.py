"""The scene file `name.f4x`: one stored zip of .npy arrays and `scene.json` (docs/scene_file.md).

A reader trusts nothing: every size is held against the bytes that are really there before memory is taken, every array
against the sha256 in `scene.json` before its header is parsed. Whatever is wrong with a file raises one F4xError.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..files import json_data, replace_file
from ..geometry.camera import CameraPath
from ..reading import DAMAGE, OWN_LIMIT, parse_json, read_npy_header, reason
from ..scaffold import Scaffold
from ..versions import SCENE_FILE
from .field import FeatureField
from .locking import updating
from .model import (
    CAMERA_ARRAYS,
    DYNAMIC_ARRAYS,
    GAUSSIAN_ARRAYS,
    KEYS,
    SCAFFOLD_ARRAYS,
    SPAN,
    DynamicSet,
    Scene,
    StaticSet,
    check_arrays,
)
from .recognise import HEADER, identify
from .runs import HELD, fold, unfold

FORMAT = "f4x"
GROUPS = {"static": GAUSSIAN_ARRAYS, "dynamic": DYNAMIC_ARRAYS, "scaffold": SCAFFOLD_ARRAYS, "cameras": CAMERA_ARRAYS}

MAX_MEMBERS = 1024
"""A scene has about 30; more is not one of ours."""
MAX_HEADER_BYTES = 256 << 20
"""scene.json holds selections of edits as lists of ids, so it may grow, but it is parsed in memory."""
MEMBER_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*")
"""No absolute path, drive, backslash or `..`: a scene can be unpacked by any tool without leaving its folder."""
_NAME_BYTE = re.compile("[\udc80-\udcff]")
"""Characters by which Python reads bytes of a file's name that are no UTF-8; JSON has an escape for them."""
MAX_SIDE = 1 << 15
"""Pixels of a picture's side; whoever renders allocates by it."""
CHUNK = 1 << 20
"""Bytes read at once, so that reading needs one copy of an array and not two."""
EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time stamp of every member: equal scenes give equal bytes."""
FIELDS: dict[str, tuple[type, ...]] = {
    "name": (str,),
    "size": (list,),
    "fps": (int, float),
    "held_out": (list,),
    "provenance": (dict,),
    "needs": (list,),
    "metrics": (dict,),
    "edits": (list,),
    "next_id": (int,),
}
"""Fields that scene.json must have, besides `format`, `version` and `arrays`."""
PROVENANCE: dict[str, tuple[type, ...]] = {
    "source": (str,),
    "frames": (str,),
    "believed_degrees": (int, float),
    "baked": (list,),
    "import": (dict,),
}
"""Entries of `provenance` that programs read; each may be absent or null."""


def read_scene(path: Path | str) -> Scene:
    """Read a scene; arrays come back read-only, one copy in memory, every sha256 checked.

    Arrays and fields this version does not know are kept in `Scene.extra` and `Scene.extra_fields`; other members of
    the zip are ignored. Raises F4xError for a missing, truncated, damaged, hostile or newer file.
    """
    path = Path(path)
    with _opened(path) as archive:
        header = _read_header(archive, path)
        arrays = {name: _read_array(archive, name, entry, path) for name, entry in header["arrays"].items()}
    try:
        with _undamaged(path):
            return _scene(header, arrays)
    except F4xError as error:
        if str(error).startswith(f"{path}:"):
            raise
        raise F4xError(f"{path}: {error}; export the scene again") from error


def read_header(path: Path | str) -> dict[str, Any]:
    """Return `scene.json` alone: quick, whatever the size of the scene. Raises F4xError like `read_scene`."""
    path = Path(path)
    with _opened(path) as archive:
        return _read_header(archive, path)


def write_scene(scene: Scene, path: Path | str) -> None:
    """Write a scene so that `path` holds either its old content or all of the new one; equal scenes give equal bytes.

    Numbers in the JSON parts that are NaN or infinite become null. It waits for another writer of the file (see `updating`).
    Raises F4xError when the disk or a field refuses.
    """
    path = Path(path)
    arrays = fold(_scene_arrays(scene))
    entries = {}
    for name, array in arrays.items():
        digest = hashlib.sha256(_npy_header(array))
        digest.update(_bytes_of(array))
        entries[name] = {"shape": list(array.shape), "dtype": array.dtype.str, "sha256": digest.hexdigest()}
    header = {
        "format": FORMAT,
        "version": 4 if HELD in arrays else 3 if scene.fades else 1 if scene.features is None else 2,
        "name": scene.name,
        "size": [scene.cameras.width, scene.cameras.height],
        "fps": scene.fps,
        "held_out": scene.held_out,
        "next_id": scene.next_id,
        "needs": scene.needs,
        "metrics": scene.metrics,
        "provenance": scene.provenance,
        "edits": scene.edits,
        "arrays": entries,
        **({} if scene.scaffold is None else {"scaffold_unit": scene.scaffold.unit}),
        **({} if scene.features is None else {"features": scene.features.to_json()}),
    }
    header |= {name: value for name, value in scene.extra_fields.items() if name not in header}
    text = _json_bytes(header, path)
    with updating(path), replace_file(path) as file, zipfile.ZipFile(file, "w") as archive:
        archive.writestr(_member(HEADER, len(text)), text)
        for name, array in arrays.items():
            npy = _npy_header(array)
            with archive.open(_member(f"{name}.npy", len(npy) + array.nbytes), "w") as stream:
                stream.write(npy)
                stream.write(_bytes_of(array))


def write_edits(
    path: Path | str,
    edits: Sequence[Mapping[str, Any]],
    next_id: int | None = None,
    fields: Mapping[str, Any] | None = None,
) -> None:
    """Replace the edit stack of the file at `path`, atomically (undo, reorder); `next_id` can only grow.

    Every other member is copied byte for byte, unknown ones too.

    `fields` are further fields of scene.json to be set, None takes one out. Who made `edits` from those of the file holds
    `updating` from reading to here. Raises F4xError and leaves the file as it was when anything is wrong.
    """
    path = Path(path)
    with updating(path):
        _write_edits(path, edits, next_id, fields or {})


def _write_edits(
    path: Path, edits: Sequence[Mapping[str, Any]], next_id: int | None, fields: Mapping[str, Any]
) -> None:
    """Copy the file with another stack, while no one else writes it."""
    with _opened(path) as source:
        header = _read_header(source, path)
    header |= {"edits": list(edits), "next_id": max(header["next_id"], next_id or 0), **fields}
    header = {name: value for name, value in header.items() if value is not None or name not in fields}
    text = _json_bytes(header, path)
    # The old file is closed before the rename: Windows does not replace an open one.
    with (
        replace_file(path) as file,
        _undamaged(path),
        zipfile.ZipFile(path) as source,
        zipfile.ZipFile(file, "w") as target,
    ):
        target.writestr(_member(HEADER, len(text)), text)
        for info in source.infolist():
            if info.filename != HEADER:
                with source.open(info) as old, target.open(_member(info.filename, info.file_size), "w") as new:
                    shutil.copyfileobj(old, new, CHUNK)


@contextmanager
def _undamaged(path: Path) -> Iterator[None]:
    """Turn whatever damaged bytes make the libraries raise into one sentence."""
    try:
        yield
    except DAMAGE as error:
        raise F4xError(f"{path}: not a whole scene file ({reason(error)}); copy or export it again") from error


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn errors of a damaged file, and of a file that cannot be opened, into F4xError."""
    try:
        with _undamaged(path):
            yield
    except FileNotFoundError as error:
        raise F4xError(f"{path}: there is no such file; choose a .f4x file") from error
    except OSError as error:
        raise F4xError(f"{path}: cannot be read ({error.strerror or error}); choose a .f4x file") from error


def _refusal(path: Path) -> str:
    """Return the sentence for a file that is no zip: its kind, and the verb that reads it."""
    try:
        identify(path)
    except F4xError:  # its sentence would offer splats, too
        return f"{path}: not a Feature4X scene; choose a .f4x file, which `f4x fit` makes of a clip"
    return f"{path}: splats, not a Feature4X scene, which this needs; `f4x open` shows them, `f4x export` converts them"


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open the zip and hold its table of contents against the bytes that are there."""
    if path.is_dir():
        raise F4xError(f"{path}: a folder without scene.f4x; give the folder of a fit, or a .f4x file")
    with _readable(path), path.open("rb") as file:
        if file.read(2) not in (b"", b"PK"):
            raise F4xError(_refusal(path))
    with _readable(path), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        names = [info.filename for info in members]
        if len(names) > MAX_MEMBERS or len(set(names)) != len(names):
            raise F4xError(f"{path}: not a scene file (too many members, or one twice); export the scene again")
        for info in members:
            if not MEMBER_NAME.fullmatch(info.filename):
                raise F4xError(
                    f"{path}: holds a member with the unsafe name {info.filename!r}; do not unpack this file"
                )
            if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
                raise F4xError(f"{path}: {info.filename} is compressed; zip the members again without compression")
        # Stored members cannot overlap in an honest file, so nothing can unfold to more than the file itself holds.
        if sum(info.file_size for info in members) > path.stat().st_size:
            raise F4xError(f"{path}: its members claim more bytes than the file has; copy or export it again")
        yield archive


def _read_header(archive: zipfile.ZipFile, path: Path) -> dict[str, Any]:
    if HEADER not in archive.namelist():
        raise F4xError(f"{path}: a zip without {HEADER}, so not a Feature4X scene; choose a .f4x file")
    if archive.getinfo(HEADER).file_size > MAX_HEADER_BYTES:
        raise F4xError(
            f"{path}: {HEADER} is larger than {MAX_HEADER_BYTES >> 20} MiB, {OWN_LIMIT}; export the scene again"
        )
    header = parse_json(archive.read(HEADER), constants=False)
    _check_header(header, path)
    return header


def _check_header(header: Any, path: Path) -> None:
    """Raise F4xError unless scene.json has every field with the type that readers rely on."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise F4xError(f"{path}: {HEADER} does not say format 'f4x', so not a Feature4X scene; choose a .f4x file")
    version = header.get("version")
    if type(version) is int and version > SCENE_FILE:
        raise F4xError(
            f"{path}: made by a newer version of Feature4X (file version {version}, this one reads {SCENE_FILE}); update"
        )
    if type(version) is not int or version < 1:
        raise F4xError(f"{path}: {HEADER} has no valid version; export the scene again")
    for name, kinds in FIELDS.items():
        if type(header.get(name)) not in kinds:
            raise F4xError(f"{path}: {HEADER} lacks a valid '{name}'; export the scene again")
    arrays = header.get("arrays")
    if not isinstance(arrays, dict) or not all(_is_entry(entry) for entry in arrays.values()):
        raise F4xError(f"{path}: {HEADER} lacks a valid 'arrays' table; export the scene again")
    known = header["provenance"]
    for name, kinds in PROVENANCE.items():
        if known.get(name) is not None and type(known[name]) not in kinds:
            raise F4xError(f"{path}: 'provenance' has no valid '{name}'; export the scene again")
    for name, rows in (("needs", header["needs"]), ("edits", header["edits"]), ("baked", known.get("baked") or [])):
        if not all(isinstance(row, dict) for row in rows):
            raise F4xError(f"{path}: '{name}' is not a list of objects; export the scene again")
    if not all(type(frame) is int for frame in header["held_out"]):
        raise F4xError(f"{path}: 'held_out' is not a list of frame indices; export the scene again")
    size = header["size"]
    if len(size) != 2 or not all(type(n) is int and 1 <= n <= MAX_SIDE for n in size):
        raise F4xError(f"{path}: 'size' is not [width, height], each 1 to {MAX_SIDE}; export the scene again")
    if not 0 <= header["next_id"] < 1 << 63:
        raise F4xError(f"{path}: 'next_id' is not a 64-bit number >= 0; export the scene again")


def _is_entry(entry: Any) -> bool:
    """Return True for a row of the arrays table: {"shape": [ints], "dtype": str, "sha256": hex}."""
    return (
        isinstance(entry, dict)
        and isinstance(entry.get("shape"), list)
        and all(type(n) is int and n >= 0 for n in entry["shape"])
        and isinstance(entry.get("dtype"), str)
        and isinstance(entry.get("sha256"), str)
    )


def _read_array(archive: zipfile.ZipFile, name: str, entry: Mapping[str, Any], path: Path) -> np.ndarray:
    """Read one array: the member's bytes into one buffer, hashed, then looked at through the .npy header."""
    try:
        info = archive.getinfo(f"{name}.npy")
    except KeyError as error:
        raise F4xError(f"{path}: the array {name} is missing; copy or export it again") from error
    member = np.empty(info.file_size, np.uint8)  # at most the size of the file, see _opened
    with archive.open(info) as stream:
        for start in range(0, len(member), CHUNK):
            piece = stream.read(CHUNK)
            member[start : start + len(piece)] = np.frombuffer(piece, np.uint8)
    if hashlib.sha256(member.data).hexdigest() != entry["sha256"]:
        raise F4xError(f"{path}: the array {name} is damaged (its sha256 differs); copy or export it again")
    head = io.BytesIO(member[:4096].tobytes())  # numpy writes 64 to 128 bytes of header
    shape, fortran, dtype = read_npy_header(head)
    if (fortran and len(shape) > 1) or dtype.kind not in "biuf" or dtype.byteorder == ">":
        raise F4xError(f"{path}: the array {name} is not a plain little-endian C-order number array; export it again")
    if list(shape) != entry["shape"] or dtype.str != entry["dtype"]:
        raise F4xError(f"{path}: the array {name} is {dtype} {shape}, {HEADER} says otherwise; export it again")
    if math.prod(shape) * dtype.itemsize != len(member) - head.tell():
        raise F4xError(f"{path}: the array {name} does not have as many numbers as its shape says; export it again")
    array = member[head.tell() :].view(dtype).reshape(shape)
    array.flags.writeable = False  # base arrays are immutable; edits make new ones
    return array


def _scene(header: Mapping[str, Any], arrays: dict[str, np.ndarray]) -> Scene:
    """Put a Scene together; the classes check what is in it."""
    if header["version"] >= 4 and HELD in arrays:
        unfold(arrays)
    static, dynamic, scaffold, cameras = (_group(arrays, group, layout) for group, layout in GROUPS.items())
    if static is None or cameras is None:
        raise F4xError("it has no " + ("cameras" if cameras is None else "static Gaussians"))
    check_arrays(cameras, CAMERA_ARRAYS, "cameras")
    if scaffold is not None:
        check_arrays(scaffold, SCAFFOLD_ARRAYS, "scaffold")
        unit: Any = header.get("scaffold_unit")
        if type(unit) not in (int, float) or not 0 < unit < math.inf:
            raise F4xError("'scaffold_unit' is not a positive number")
        scaffold["unit"] = float(unit)
    spans = [arrays.pop(f"{part}/{SPAN}", None) if header["version"] >= 3 else None for part in ("static", "dynamic")]
    field_header = header.get("features") if header["version"] >= 2 else None
    features = None if field_header is None else FeatureField.take_from(arrays, field_header)
    known = {*FIELDS, "format", "version", "arrays", "scaffold_unit", *([] if field_header is None else ["features"])}
    return Scene(
        name=header["name"],
        static=StaticSet(**static, span=spans[0]),
        dynamic=DynamicSet.empty() if dynamic is None else DynamicSet(**dynamic, span=spans[1]),
        scaffold=None if scaffold is None else Scaffold(**scaffold),
        cameras=CameraPath(**cameras, width=header["size"][0], height=header["size"][1]),
        fps=float(header["fps"]),
        held_out=tuple(header["held_out"]),
        provenance=header["provenance"],
        needs=tuple(header["needs"]),
        metrics=header["metrics"],
        edits=tuple(header["edits"]),
        next_id=header["next_id"],
        features=features,
        extra=arrays,  # what no group took
        extra_fields={name: value for name, value in header.items() if name not in known},
    )


def _group(arrays: dict[str, np.ndarray], group: str, layout: Mapping[str, Any]) -> dict[str, Any] | None:
    """Take the arrays of one group out of `arrays`; None when the file has none of them."""
    keys = {name: _key(group, name) for name in layout}
    found = {name: arrays.pop(key) for name, key in keys.items() if key in arrays}
    if found and len(found) < len(layout):
        raise F4xError(f"the array {next(key for name, key in keys.items() if name not in found)} is missing")
    return found or None


def _key(group: str, name: str) -> str:
    """Return the member of the file that holds the array `name` of a group."""
    return f"{group}/{KEYS.get(name, name)}"


def _scene_arrays(scene: Scene) -> dict[str, np.ndarray]:
    """Return all arrays of the file by name, in the file's dtypes, C order; parts a scene does not need are left out."""
    parts = {"static": scene.static, "dynamic": scene.dynamic, "scaffold": scene.scaffold, "cameras": scene.cameras}
    arrays = {
        _key(group, name): np.ascontiguousarray(getattr(parts[group], name), dtype)
        for group, layout in GROUPS.items()
        if parts[group] is not None and (group != "dynamic" or len(scene.dynamic))
        for name, (dtype, _) in layout.items()
    }
    more = {
        f"{part}/{SPAN}": np.ascontiguousarray(held.span, "<f4")
        for part, held in (("static", scene.static), ("dynamic", scene.dynamic))
        if held.span is not None and (part == "static" or len(held))
    }
    more |= {} if scene.features is None else scene.features.to_arrays()
    clashes = scene.extra.keys() & {
        HELD,
        *(_key(group, name) for group, layout in GROUPS.items() for name in layout),
        *more,
    }
    for name, value in [*more.items(), *scene.extra.items()]:
        if name in clashes or not MEMBER_NAME.fullmatch(name) or value.dtype.kind not in "biuf":
            raise F4xError(f"array {name!r}: use a new name of letters, digits, '_', '-' and '/', and plain numbers")
        arrays[name] = np.ascontiguousarray(value, value.dtype.newbyteorder("<")).reshape(value.shape)
    return arrays


def _npy_header(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, np.lib.format.header_data_from_array_1_0(array))
    return stream.getvalue()


def _bytes_of(array: np.ndarray) -> memoryview:
    """Return the raw bytes of a C-order array, without a copy."""
    return array.reshape(-1).view(np.uint8).data


def _member(name: str, size: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, EPOCH)
    info.file_size = size  # tells zipfile whether the member needs ZIP64
    info.external_attr = 0o644 << 16
    return info


def _json_bytes(header: Mapping[str, Any], path: Path) -> bytes:
    """Return the bytes of scene.json, which every reader will accept: checked here, before anything is replaced."""
    header = json_data(header)
    _check_header(header, path)
    try:
        readable = json.dumps(header, allow_nan=False, ensure_ascii=False, indent=1)
        text = _NAME_BYTE.sub(lambda byte: f"\\u{ord(byte[0]):04x}", readable).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise F4xError(f"{path}: a field of the scene cannot be written as JSON ({error})") from error
    if len(text) > MAX_HEADER_BYTES:
        raise F4xError(f"{path}: {HEADER} would exceed {MAX_HEADER_BYTES >> 20} MiB; bake or shorten the edits")
    return text
