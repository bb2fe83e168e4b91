"""Reads the splats of glTF files, .glb and .gltf: primitives with `KHR_gaussian_splatting`, placed by their nodes.

Names, types and rules are those of the extension's text (Khronos, 2026). Its one kernel, `ellipse`, in display sRGB is read, with
every component type that it allows. Files whose splats are compressed by a further extension are refused.
"""

from __future__ import annotations

import base64
import binascii
import os
import struct
from collections import deque
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...errors import F4xError
from ...geometry import quaternion, spherical_harmonics
from ...geometry.similarity import Similarity
from ...geometry.splats import Splats
from ...reading import DAMAGE, FREE_BYTES, MAX_INFLATION, OWN_LIMIT, parse_json, quoted, reason
from ..linear import narrowed
from ..posing import Y_UP, similarity_of
from .gltf import BIN_CHUNK, COLOR_SPACE, ELEMENT_TYPES, EXTENSION, FOOTPRINT, GLB_MAGIC, JSON_CHUNK, KERNEL, MAX_DEGREE

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {name: width for width, name in ELEMENT_TYPES.items()}
CONVERT = "convert it to a 3DGS PLY with a splat editor first"
READ_EXTENSIONS = {EXTENSION, "KHR_mesh_quantization"}
"""Extensions that a file may require; the second allows the integer types of `COMPONENTS`."""
MOVES = {"matrix", "rotation", "scale", "translation"}
"""Properties that move a node; a node without any stands where its parent does."""
FAMILY = "gaussian_splat"
"""In the names of the extension, of those that compress its splats, and of earlier ones by other authors."""
MAX_PLACED = 10_000_000
"""Splats of a file with all repetitions, as many as are read of SPZ."""
MAX_NODES = 50_000
"""Nodes of a file, and primitives of splats that they place; each takes a ten-thousandth of a second. Honest files have some
hundred."""
PLACED_BYTES = 56
"""Bytes in memory of a splat without view dependence. Few bytes of a file can name one part 20,000 times."""


def holds_splats(path: Path) -> bool:
    """Return True where the JSON of a .glb or .gltf file names the extension, or one of its family."""
    with path.open("rb") as file:
        start = file.read(20)
        size = os.fstat(file.fileno()).st_size
        if start.startswith(GLB_MAGIC) and len(start) == 20:
            size = min(size, struct.unpack_from("<I", start, 12)[0])
        return FAMILY.encode() in (start + file.read(size)).lower()


def read_gltf(path: Path | str) -> Splats:
    """Read the splats of all nodes into the axes of PLY files (x right, y down, z forward); means in float64.

    Raises F4xError that names what is damaged, missing or of a kind that is not read.
    """
    path = Path(path)
    try:
        document, binary = _read_document(path)
        file = _GltfFile(document, binary, path)
        found = list(file.splat_primitives())
        if not found:
            raise F4xError(_why_none(document))
        _require_extensions(document)
        file.require_honest(primitive for primitive, _ in found)
        with np.errstate(over="ignore", invalid="ignore"):  # the scene refuses what is not finite
            return _joined([(file.splats(primitive), similarity_of(Y_UP @ matrix)) for primitive, matrix in found])
    except F4xError as error:
        raise F4xError(f"{path}: {error}") from error
    except OSError as error:
        raise F4xError(f"{path}: cannot be read ({error.strerror or error}); copy or export it again") from error
    except DAMAGE as error:
        raise F4xError(f"{path}: a damaged glTF file ({reason(error)}); copy or export it again") from error


def _read_document(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a file and the binary chunk of a .glb."""
    data = path.read_bytes()
    if not data.startswith(GLB_MAGIC):
        return parse_json(data), b""
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<I4s", data, at)
        if kind not in chunks:
            chunks[kind] = data[at + 8 : at + 8 + size]
        at += 8 + size
    return parse_json(chunks[JSON_CHUNK]), chunks.get(BIN_CHUNK, b"")


def _why_none(document: dict[str, Any]) -> str:
    """Describe a file that names splats and has no primitive of the extension in its scene."""
    used = document.get("extensionsUsed")
    foreign = [str(name) for name in used if FAMILY in str(name).lower() and name != EXTENSION] if used else []
    if foreign:
        names = quoted(", ".join(foreign))
        return f"its splats are compressed or of an earlier draft ({names}), which is not read; {CONVERT}"
    return "a glTF file without splats; import it in Blender, or take the splats' PLY"


class _GltfFile:
    """Reader of the attributes of a file's primitives and of the transforms of its nodes."""

    def __init__(self, document: dict[str, Any], binary: bytes, path: Path) -> None:
        self.document, self.binary, self.path = document, binary, path
        self.buffers: dict[int, bytes] = {}
        self.read: dict[int, np.ndarray] = {}
        self.meshes: dict[int, list[dict[str, Any]]] = {}
        self.parts: dict[int, Splats] = {}

    def splat_primitives(self) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
        """Yield each primitive of splats below the file's scene, with the 4x4 matrix of its node to the world."""
        nodes = self.document.get("nodes", [])
        if len(nodes) > MAX_NODES:
            raise F4xError(f"it has {len(nodes):,} nodes; more than {MAX_NODES:,} is {OWN_LIMIT}; export a PLY")
        scenes = self.document.get("scenes")
        roots = scenes[self.document.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
        world = np.eye(4)
        waiting, seen, placed = deque((index, world) for index in roots), set(), 0
        while waiting:
            index, matrix = waiting.popleft()
            if index in seen:  # nodes are a tree
                continue
            seen.add(index)
            node = nodes[index]
            if not MOVES.isdisjoint(node):
                matrix = matrix @ _local_matrix(node)
            waiting += [(child, matrix) for child in node.get("children", [])]
            for primitive in self.primitives_of(node["mesh"]) if "mesh" in node else ():
                placed += 1
                if placed > MAX_NODES:
                    raise F4xError(f"its nodes place more than {MAX_NODES:,} parts, {OWN_LIMIT}; export a PLY")
                yield primitive, matrix

    def primitives_of(self, mesh: int) -> list[dict[str, Any]]:
        """Return the primitives of splats of a mesh."""
        if mesh not in self.meshes:
            primitives = self.document["meshes"][mesh]["primitives"]
            self.meshes[mesh] = [each for each in primitives if EXTENSION in each.get("extensions", {})]
        return self.meshes[mesh]

    def require_honest(self, primitives: Iterator[dict[str, Any]]) -> None:
        """Raise F4xError where `primitives` repeat what the file holds so often that they stand for far more than it."""
        placed, buffers = 0, set()
        for primitive in primitives:
            accessor = self.document["accessors"][primitive["attributes"]["POSITION"]]
            placed += int(accessor["count"])
            if "bufferView" in accessor:
                buffers.add(self.document["bufferViews"][accessor["bufferView"]]["buffer"])
        present = sum(len(self.buffer(index)) for index in buffers)
        if placed > MAX_PLACED or placed * PLACED_BYTES > max(FREE_BYTES, MAX_INFLATION * present):
            raise F4xError(
                f"its nodes place {placed:,} splats, with {present:,} bytes of them there; more than {MAX_PLACED:,}, or than"
                f" {MAX_INFLATION} times those bytes, is {OWN_LIMIT}; export a PLY"
            )

    def splats(self, primitive: dict[str, Any]) -> Splats:
        """Return the Gaussians of a primitive in the axes of its node; harmonics with directions in these axes, too."""
        if id(primitive) not in self.parts:
            self.parts[id(primitive)] = self._splats(primitive)
        return self.parts[id(primitive)]

    def _splats(self, primitive: dict[str, Any]) -> Splats:
        names = primitive["attributes"]
        _require_known(primitive["extensions"][EXTENSION], names)
        degree = max(d for d in range(MAX_DEGREE + 1) if d == 0 or f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in names)
        harmonics = [f"SH_DEGREE_{d}_COEF_{order}" for d in range(degree + 1) for order in range(2 * d + 1)]
        parts = {name: self.values(names[f"{EXTENSION}:{name}"]) for name in ("ROTATION", "SCALE", "OPACITY")}
        footprint = self.values(names[FOOTPRINT])[:, 0] if FOOTPRINT in names else None
        if footprint is not None and footprint.shape != parts["SCALE"].shape[:1]:
            raise F4xError(f"the attribute {FOOTPRINT} has another count than its splats; export it again")
        found = Splats(
            means=self.values(names["POSITION"]),
            quats=parts["ROTATION"][:, [3, 0, 1, 2]],
            scales=parts["SCALE"] if footprint is None else narrowed(parts["SCALE"], footprint),
            opacities=parts["OPACITY"][:, 0],
            sh=np.stack([self.values(names[f"{EXTENSION}:{name}"]) for name in harmonics], axis=1),
        )
        if any(len(array) != len(found) for array in found.arrays().values()):
            raise F4xError("the attributes of its splats have differing counts; export it again")
        return found

    def values(self, index: int) -> np.ndarray:
        """Return (n,k) float32 of an accessor; normalised integers as glTF 2.0, section 3.11, decodes them."""
        if index not in self.read:
            self.read[index] = self._values(index)
        return self.read[index]

    def _values(self, index: int) -> np.ndarray:
        accessor = self.document["accessors"][index]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise F4xError(f"its splats are compressed or sparse; {CONVERT}")
        view = self.document["bufferViews"][accessor["bufferView"]]
        if view.get("extensions"):
            raise F4xError(f"its splats are compressed ({quoted(', '.join(view['extensions']))}); {CONVERT}")
        kind, width, count = (
            np.dtype(COMPONENTS[accessor["componentType"]]),
            WIDTHS[accessor["type"]],
            accessor["count"],
        )
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        row = kind.itemsize * width
        stride = view.get("byteStride", row)
        buffer = self.buffer(view["buffer"])
        if min(start, count - 1) < 0 or stride < row or start + stride * (count - 1) + row > len(buffer):
            raise F4xError(f"truncated, it promises {quoted(count)} splats; copy or export it again")
        values = np.ndarray((count, width), kind, buffer, start, (stride, kind.itemsize)).astype(np.float32)
        return np.maximum(values / np.iinfo(kind).max, -1) if accessor.get("normalized") else values

    def buffer(self, index: int) -> bytes:
        """Return the bytes of a buffer: of the .glb, inside the JSON, or of a file in the same folder or below."""
        if index not in self.buffers:
            uri = self.document["buffers"][index].get("uri")
            self.buffers[index] = self.binary if uri is None else self._bytes_of(uri)
        return self.buffers[index]

    def _bytes_of(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error as error:
                raise F4xError("the data inside are damaged; copy or export it again") from error
        if "://" in uri:
            raise F4xError(f"its data are at {quoted(uri)}, and nothing is fetched; export it as .glb")
        name = PurePosixPath(unquote(uri))
        if name.is_absolute() or ".." in name.parts or any(mark in str(name) for mark in "\\:"):
            raise F4xError("its data lie outside its own folder, where none are read; export it as .glb")
        file = self.path.parent / name
        if file.exists() and not file.is_file():  # opening a pipe would wait for ever
            raise F4xError(f"its data are in {quoted(name)}, which is no ordinary file; export it as .glb")
        return file.read_bytes()


def _require_extensions(document: dict[str, Any]) -> None:
    """Raise F4xError where the file says that it cannot be read without an extension that is not read here."""
    unknown = [str(name) for name in document.get("extensionsRequired", ()) if name not in READ_EXTENSIONS]
    if unknown:
        raise F4xError(f"it requires {quoted(', '.join(unknown))}, which is not read; {CONVERT}")


def _require_known(extension: dict[str, Any], names: dict[str, Any]) -> None:
    """Raise F4xError for splats that would be drawn wrongly; `names` of their attributes."""
    if extension.get("extensions"):
        raise F4xError(f"its splats need {quoted(', '.join(extension['extensions']))}, which is not read; {CONVERT}")
    if not any(name.startswith(f"{EXTENSION}:") for name in names):
        raise F4xError(f"its splats are of an earlier draft of {EXTENSION}, which is not read; {CONVERT}")
    for key, read in (("kernel", KERNEL), ("colorSpace", COLOR_SPACE)):
        if extension[key] != read:
            raise F4xError(f"splats with {key} '{quoted(extension[key])}', of which only '{read}' is read; {CONVERT}")


def _local_matrix(node: dict[str, Any]) -> np.ndarray:
    """Return the 4x4 matrix of a node to its parent (glTF 2.0, section 3.5.3)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = np.eye(4)
    matrix[:3, :3] = quaternion.to_matrix(np.array([w, x, y, z], np.float64)) * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _joined(placed: list[tuple[Splats, Similarity]]) -> Splats:
    """Move Gaussians by their nodes and join them in one set.

    Their harmonics are in each Gaussian's own frame, which turns along.
    """
    parts, moves = zip(*placed, strict=True)
    counts = [len(splats) for splats in parts]
    count = max(splats.sh.shape[1] for splats in parts)
    sh = np.concatenate([np.pad(each.sh, ((0, 0), (0, count - each.sh.shape[1]), (0, 0))) for each in parts])
    means, quats, scales, opacities = (
        np.concatenate([getattr(each, name) for each in parts]) for name in ("means", "quats", "scales", "opacities")
    )
    scale, turn, shift = (
        np.repeat(np.array([getattr(move, name) for move in moves]), counts, axis=0)
        for name in ("scale", "rotation", "translation")
    )
    return Splats(
        scale[:, None] * quaternion.rotate(turn, means.astype(np.float64)) + shift,
        quaternion.multiply(turn, quats.astype(np.float64)).astype(np.float32),
        (scale[:, None] * scales).astype(np.float32),
        opacities,
        spherical_harmonics.rotate(sh, quaternion.conjugate(quats)),
    )
