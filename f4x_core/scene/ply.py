"""Standard 3DGS PLY files: a tolerant reader, an exact writer, and the scene at one moment.

On disk: opacity is a logit, scale a natural logarithm, `f_rest_*` channel-major (all red, all green, all blue),
rotation wxyz, SH directions in world axes. In memory: activated values, and SH in the Gaussian's own frame.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from ..geometry import quaternion, spherical_harmonics
from ..geometry.splats import Splats
from ..reading import OWN_LIMIT, bytes_left, quoted
from .posing import Posable, moment

TYPE_NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
"""numpy code -> the names it has in PLY headers, the written one first."""
TYPE_CODES = {name: code for code, names in TYPE_NAMES.items() for name in names}
MAX_HEADER_BYTES = 1 << 16
"""A splat header has 2 KB; the cap stops a search for `end_header` in a file that is something else."""
POSITION = ("x", "y", "z")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
REQUIRED = (*POSITION, *DC, "opacity", *SCALE, *ROTATION)
MIN_SCALE = 1e-12
"""World units; a scale of 0 has no logarithm."""
OPACITY_MARGIN = 1e-6
"""Opacities 0 and 1 have no finite logit; a change of this size is invisible in 8 and 16 bits."""
MIN_TELLING = 10
"""Splats from which the range of their numbers tells whether they are activated: so many logits hardly all lie in [0, 1]."""
HUGE = 0.1
"""A typical Gaussian of this part of the scene's extent, or more, is too large to be one: its scale was no logarithm."""
MAX_NUMBER_CHARS = 64
"""Maximum characters of a number in an ASCII file with the space behind it; a double takes 25."""
TEXT_BLOCK = 1 << 20
"""Characters of an ASCII file that become numbers at once: as Python's own they take twenty times the memory."""
ROW_BLOCK = 1 << 18
"""Splats that are converted at once, in float64."""


@dataclass(frozen=True)
class Activation:
    """Kinds of numbers of a PLY that are activated already, as some programs write them, in place of logits and logarithms."""

    opacities: bool = False
    scales: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for a person about how the file was read; none for a standard file."""
        names = " and ".join(name for name, value in vars(self).items() if value)
        return (f"its {names} are activated already (no logits, no logarithms) and were read so",) if names else ()


def write_ply(path: Path | str, splats: Splats, offset: np.ndarray | None = None) -> None:
    """Write a binary 3DGS PLY with the standard names and order (248 bytes per Gaussian at degree 3).

    The harmonics are turned from each Gaussian's own frame to world axes, as every other viewer expects. With an `offset` (3,)
    that is not 0 the positions are written as doubles, moved by it. Raises F4xError when the disk refuses.
    """
    means, sh = splats.means, splats.sh
    far = offset is not None and offset.any()
    if far:
        means = means.astype(np.float64) + offset
    quats = quaternion.normalize(splats.quats)
    world_sh = spherical_harmonics.rotate(sh, quats)
    rest = world_sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), 3 * (sh.shape[1] - 1))  # (N, 3 (S - 1)) channel-major
    opacity = np.clip(splats.opacities.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    columns = {
        **dict(zip(POSITION, means.T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), np.zeros(len(means))),
        **dict(zip(DC, world_sh[:, 0].T, strict=True)),
        **{f"f_rest_{i}": column for i, column in enumerate(rest.T)},
        "opacity": np.log(opacity / (1 - opacity)),
        **dict(zip(SCALE, np.log(np.maximum(splats.scales, MIN_SCALE)).T, strict=True)),
        **dict(zip(ROTATION, quats.T, strict=True)),
    }
    vertices = np.empty(len(means), [(name, "<f8" if far and name in POSITION else "<f4") for name in columns])
    for name, column in columns.items():
        vertices[name] = column
    write_properties(path, vertices)


def read_ply(path: Path | str) -> Splats:
    """Read a 3DGS PLY: any property order and type, comments, CRLF header, degree 0 to 4, normals or not.

    Binary of either byte order, or ASCII. SH is turned from world axes to each Gaussian's own frame, so
    `write_ply(path, read_ply(path))` is a round trip. Means are float64 where the file has doubles. Raises F4xError that says
    what the file is when it is no splat file, is truncated or has impossible values.
    """
    return read_ply_activation(path)[0]


def read_ply_activation(path: Path | str) -> tuple[Splats, Activation]:
    """Read as `read_ply`; also return which numbers were activated in the file, as their ranges tell."""
    path = Path(path)
    vertices = read_properties(path)
    names = vertices.dtype.names or ()
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise F4xError(f"{path}: {_what_it_is(names, missing, _has_faces(path))}")
    rest_names = sorted((name for name in names if re.fullmatch(r"f_rest_\d+", name)), key=lambda name: int(name[7:]))
    rest = len(rest_names) // 3
    if len(rest_names) not in (0, 9, 24, 45, 72) or rest_names != [f"f_rest_{i}" for i in range(3 * rest)]:
        raise F4xError(f"{path}: has {len(rest_names)} f_rest properties, expected 0, 9, 24, 45 or 72; export it again")
    activation = _activation(vertices)
    doubles = any(vertices.dtype[name] == np.float64 for name in POSITION)
    count = len(vertices)
    splats = Splats(
        np.empty((count, 3), np.float64 if doubles else np.float32),
        np.empty((count, 4), np.float32),
        np.empty((count, 3), np.float32),
        np.empty(count, np.float32),
        np.empty((count, rest + 1, 3), np.float32),
    )
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is counted below
        for start in range(0, count, ROW_BLOCK):
            rows = slice(start, start + ROW_BLOCK)
            part = _splats_of(vertices[rows], rest_names, activation)
            for name, value in part.arrays().items():
                getattr(splats, name)[rows] = value
    for name, value in splats.arrays().items():
        bad = np.count_nonzero(~np.isfinite(value.reshape(len(value), -1)).all(axis=1)) if len(value) else 0
        if bad:
            hint = "scale_* must be logarithms" if name == "scales" else "clean it in a splat editor"
            raise F4xError(f"{path}: {bad} of {len(value)} splats have no finite {name}; {hint}")
    return splats, activation


def _splats_of(vertices: np.ndarray, rest_names: list[str], activation: Activation) -> Splats:
    """Return the Gaussians of some rows, in float64."""
    rest = len(rest_names) // 3
    opacities, scales = _columns(vertices, ("opacity",))[:, 0], _columns(vertices, SCALE)
    sh = np.empty((len(vertices), rest + 1, 3))
    sh[:, 0] = _columns(vertices, DC)
    sh[:, 1:] = _columns(vertices, rest_names).reshape(len(vertices), 3, rest).transpose(0, 2, 1)
    quats = quaternion.normalize(_columns(vertices, ROTATION))
    return Splats(
        means=_columns(vertices, POSITION),
        quats=quats,
        scales=scales if activation.scales else np.exp(scales),
        # exp of a large negative logit is inf, and 1 / (1 + inf) the right 0
        opacities=opacities if activation.opacities else 1 / (1 + np.exp(-opacities)),
        sh=spherical_harmonics.rotate(sh, quaternion.conjugate(quats)),
    )


def _activation(vertices: np.ndarray) -> Activation:
    """Find the kinds of numbers that are activated, by their ranges.

    Trained logits leave [0, 1]; all of 0 are logits, for nothing would be seen of such opacities. A logarithm of a scale is
    negative below 1 unit; where none is, the scales are activated if the opacities are, or if the Gaussians would otherwise be as
    large as the scene.
    """
    if len(vertices) < MIN_TELLING:
        return Activation()
    opacity = vertices["opacity"]
    opacities = bool((opacity >= 0).all() and (opacity <= 1).all() and opacity.any())
    if not all((vertices[name] >= 0).all() for name in SCALE):
        return Activation(opacities)
    extent = max(float(np.ptp(np.percentile(vertices[name].astype(np.float64), (5, 95)))) for name in POSITION)
    typical = max(float(np.median(vertices[name].astype(np.float64))) for name in SCALE)
    with np.errstate(over="ignore", invalid="ignore"):
        return Activation(opacities, opacities or bool(np.exp(typical) > HUGE * extent > HUGE * typical))


def read_properties(path: Path | str) -> np.ndarray:
    """Return the vertices of a PLY as a structured array (N,), every property as it is on disk.

    `write_properties` writes it back bit for bit (ASCII numbers become their binary types). Other elements are
    skipped. Raises F4xError.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            order, elements = _read_header(file, path)
            for name, count, dtype in elements:
                if order == "ascii":
                    if name == "vertex":
                        return _parse_vertices(file, count, dtype, path)
                    deque(islice(file, count), maxlen=0)
                else:
                    if name == "vertex":
                        return _read_vertices(file, count, dtype.newbyteorder(order), path)
                    file.seek(count * dtype.itemsize, 1)
    except OSError as error:
        raise F4xError(f"{path}: cannot be read ({error.strerror or error})") from error
    raise F4xError(f"{path}: a PLY without vertices; choose a Gaussian-splat PLY")


def write_properties(path: Path | str, vertices: np.ndarray) -> None:
    """Write a structured array (N,) of plain numbers as the vertices of a binary little-endian PLY."""
    dtype = vertices.dtype
    names = dtype.names or ()
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property {TYPE_NAMES[dtype[name].str[1:]][0]} {name}" for name in names]
    packed = np.ascontiguousarray(vertices, dtype.newbyteorder("<"))
    with replace_file(path) as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        file.write(packed.view(np.uint8).data)


def export_frame(scene: Posable, time: float, path: Path | str, transform: np.ndarray | None = None) -> None:
    """Write what is visible of the scene at clip time `time` as one 3DGS PLY.

    `transform`: a 4x4 similarity in the scene's axes (an object's matrix in a modelling program), baked into position,
    rotation, scale and harmonics. Raises F4xError.
    """
    write_ply(path, moment(scene, time, transform), scene.offset)


def _read_header(file: BinaryIO, path: Path) -> tuple[Literal["<", ">", "ascii"], list[tuple[str, int, np.dtype]]]:
    """Return the byte order, or "ascii", and (name, count, dtype of one row) of every element up to the vertices."""
    if file.readline(8).rstrip(b"\r\n") != b"ply":
        raise F4xError(f"{path}: not a PLY file; choose a Gaussian-splat PLY")
    order: Literal["", "<", ">", "ascii"] = ""
    left = MAX_HEADER_BYTES
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    while left > 0:
        line = file.readline(left)
        left -= len(line)
        words = line.decode("ascii", "replace").split()
        if not line.endswith(b"\n"):
            break
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", "ascii", *_]:
                order = "ascii"
            case ["format", "binary_little_endian" | "binary_big_endian" as name, *_]:
                order = "<" if name == "binary_little_endian" else ">"
            case ["element", name, count] if count.isdecimal() and len(count) < 13:
                elements.append((name, int(count), []))
            case ["property", kind, name] if kind in TYPE_CODES and elements:
                elements[-1][2].append((name, TYPE_CODES[kind]))
            case ["property", "list", *_] if elements and "vertex" in [element[0] for element in elements[:-1]]:
                pass  # faces behind the vertices are never read
            case ["end_header"] if order:
                return order, [(name, count, _row(properties, path)) for name, count, properties in elements]
            case _:
                raise F4xError(
                    f"{path}: the PLY header has a line that cannot be read ({quoted(line)}); export it again"
                )
    if left <= 0:
        raise F4xError(
            f"{path}: the PLY header is longer than {MAX_HEADER_BYTES >> 10} KiB, {OWN_LIMIT}; shorten its comments, or export it"
            " again"
        )
    raise F4xError(f"{path}: the PLY header has no end; the file is truncated or no PLY")


def _row(properties: list[tuple[str, str]], path: Path) -> np.dtype:
    if len({name for name, _ in properties}) != len(properties):
        raise F4xError(f"{path}: the PLY header names a property twice; export it again")
    return np.dtype(properties)


def _read_vertices(file: BinaryIO, count: int, dtype: np.dtype, path: Path) -> np.ndarray:
    if not dtype.itemsize:
        raise F4xError(f"{path}: a PLY whose vertices have no properties; choose a Gaussian-splat PLY")
    held = bytes_left(file) // dtype.itemsize
    if held < count:  # before any memory is taken
        raise F4xError(f"{path}: truncated, it promises {count} splats and holds {held}; copy or export it again")
    return np.fromfile(file, dtype, count)


def _parse_vertices(file: BinaryIO, count: int, dtype: np.dtype, path: Path) -> np.ndarray:
    """Return the rows of an ASCII PLY, one line each."""
    names = dtype.names or ()
    if not names:
        raise F4xError(f"{path}: a PLY whose vertices have no properties; choose a Gaussian-splat PLY")
    promised = f"{path}: truncated, it promises {count} splats"
    if count * 2 * len(names) > bytes_left(file) + 1:  # a digit and a space each: before any memory is taken
        raise F4xError(f"{promised} and holds fewer; copy or export it again")
    rows = np.empty(count, dtype)
    longest = MAX_NUMBER_CHARS * len(names)
    block = max(1, TEXT_BLOCK // longest)
    for start in range(0, count, block):
        part = rows[start : start + block]
        lines = [file.readline(longest) for _ in range(len(part))]
        try:
            # The flat parser is several times quicker than one that knows columns; it reads nan and inf as well.
            numbers = np.array(b" ".join(lines).split(), np.float64)
        except ValueError as error:
            raise F4xError(f"{path}: holds something other than numbers among its splats; export it again") from error
        if len(numbers) != part.size * len(names):
            held = start * len(names) + len(numbers)
            raise F4xError(f"{promised} of {len(names)} numbers and holds {held}; copy or export it again")
        with np.errstate(invalid="ignore", over="ignore"):  # too large for a narrow type
            for name, column in zip(names, numbers.reshape(part.size, len(names)).T, strict=True):
                part[name] = column
    return rows


def _has_faces(path: Path) -> bool:
    """Return True if the header, read once before, also lists faces, as a mesh has them."""
    with path.open("rb") as file:
        return any(name == "face" and count for name, count, _ in _read_header(file, path)[1])


def _what_it_is(names: tuple[str, ...], missing: list[str], has_faces: bool) -> str:
    """Return the sentence for a PLY that does not hold plain splats."""
    if "packed_position" in names:
        return "a compressed splat PLY; convert it to a plain 3DGS PLY first"
    if not {"opacity", *SCALE, *ROTATION, *DC} & set(names):
        kind = "mesh" if has_faces else "point cloud"
        return f"a plain {kind} without splat properties (opacity, scale_*, rot_*, f_dc_*); import it as a {kind}"
    return f"a splat PLY that lacks {', '.join(missing)}; export it again as a standard 3DGS PLY"


def _columns(vertices: np.ndarray, names: tuple[str, ...] | list[str]) -> np.ndarray:
    """Return the named properties as (N, len(names)) float64."""
    return np.stack([vertices[name].astype(np.float64) for name in names], 1) if names else np.zeros((len(vertices), 0))
