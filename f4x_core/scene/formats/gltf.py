"""glTF 2.0 with `KHR_gaussian_splatting`: one moment as Gaussians, which other viewers draw as coloured points.

Attribute names, types and colour space follow the extension's text (Khronos, the release candidate of 2026, which was ratified):
linear scale, opacity in [0, 1], unit rotation xyzw, harmonics by degree and order with the
Condon-Shortley phase, which are the signs of 3DGS. glTF's axes are y up, z backward: data are turned on the way out,
harmonics too, because not every viewer turns those with the node.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import F4xError
from ...files import replace_file
from ...geometry import quaternion
from ..color import linear_from_srgb
from ..linear import footprint, footprint_in, with_footprint
from ..posing import Y_UP, Posable, plain_color, transformed, visible, world_harmonics

EXTENSION = "KHR_gaussian_splatting"
FOOTPRINT = "_FOOTPRINT"
"""Our attribute of splats: the standard deviation that `SCALE` has in it beside the fitted one, as this core needs it back."""
KERNEL, COLOR_SPACE = "ellipse", "srgb_rec709_display"
"""The required properties of the extension: an ellipse whose composited colours are display sRGB."""
MAX_DEGREE = 3
"""The extension names no coefficients beyond."""
GLB_MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", b"JSON", b"BIN\0"
MAX_GLB_BYTES = (1 << 32) - 1
"""Lengths in a .glb file are 32-bit."""
ELEMENT_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
FLOAT, USHORT, UINT, POINTS, ARRAY_BUFFER = 5126, 5123, 5125, 0, 34962
KINDS = {FLOAT: "<f4", USHORT: "<u2", UINT: "<u4"}


class GltfBuffer:
    """The buffer of a file, and the views and accessors into it."""

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.pieces: list[bytes] = []
        self.length = 0

    def add(self, values: np.ndarray, kind: int = FLOAT, target: int | None = None, bounds: bool = False) -> int:
        """Return the accessor of `values (n,c)`, or `(n,4,4)`; `bounds`: with the smallest and the largest."""
        values = np.ascontiguousarray(values, KINDS[kind])
        view = {"buffer": 0, "byteOffset": self.length, "byteLength": values.nbytes}
        self.views.append(view | ({} if target is None else {"target": target}))
        shape = "MAT4" if values.ndim == 3 else ELEMENT_TYPES[values.shape[1]]
        accessor = {"bufferView": len(self.accessors), "componentType": kind, "count": len(values), "type": shape}
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        self.pieces.append(values.tobytes() + bytes(-values.nbytes % 4))
        self.length += len(self.pieces[-1])
        return len(self.accessors) - 1

    def joined(self) -> bytes:
        """Return the whole buffer."""
        return b"".join(self.pieces)


def write_gltf(scene: Posable, time: float, path: Path | str, transform: np.ndarray | None = None) -> None:
    """Write the scene at clip time `time` as .glb, or as .gltf with its numbers inside.

    `transform`: a 4x4 similarity in the scene's axes. Raises F4xError when nothing is visible then, or beyond 4 GiB.
    """
    path = Path(path)
    whole = scene.posed(time)
    fitted, posed = (
        transformed(visible(each, transform), Y_UP) for each in (whole, with_footprint(whole, footprint(scene)))
    )
    if not len(posed.ids):
        raise F4xError(
            f"{path}: nothing is visible at clip time {time:g}, and glTF holds no empty points; choose another"
        )
    color = np.concatenate([linear_from_srgb(plain_color(posed)), posed.opacities[:, None]], axis=1)
    harmonics = world_harmonics(posed, MAX_DEGREE)
    attributes = {
        "POSITION": posed.means,
        "COLOR_0": color,
        f"{EXTENSION}:ROTATION": quaternion.normalize(posed.quats)[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": posed.scales,
        FOOTPRINT: footprint_in(posed.scales, fitted.scales)[:, None],
        f"{EXTENSION}:OPACITY": posed.opacities[:, None],
    } | {
        f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}": harmonics[:, degree**2 + order]
        for degree in range(MAX_DEGREE + 1)
        for order in range(2 * degree + 1)
        if (degree + 1) ** 2 <= harmonics.shape[1]
    }
    document, binary = _document(scene.name, attributes)
    if scene.offset.any():  # in double precision, as text
        document["nodes"][0]["translation"] = (Y_UP[:3, :3] @ scene.offset).tolist()
    document["scenes"][0]["extras"] = {"clip_time": float(time), "frames_per_second": float(scene.fps)}
    if path.suffix.lower() == ".gltf":
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
        data = json.dumps(document, indent=1).encode()
    else:
        data = glb(document, binary, path)
    with replace_file(path) as file:
        file.write(data)


def _document(name: str, attributes: dict[str, np.ndarray]) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of one primitive with `attributes (N,k)`, and the buffer its accessors look into."""
    buffer = GltfBuffer()
    for semantic, values in attributes.items():
        buffer.add(values, target=ARRAY_BUFFER, bounds=semantic == "POSITION")
    primitive = {
        "mode": POINTS,
        "attributes": {semantic: index for index, semantic in enumerate(attributes)},
        "extensions": {
            EXTENSION: {
                "kernel": KERNEL,
                "colorSpace": COLOR_SPACE,
                "projection": "perspective",
                "sortingMethod": "cameraDistance",
            }
        },
    }
    return {
        "asset": {"version": "2.0", "generator": "Feature4X for Blender"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.length}],
    }, buffer.joined()


def glb(document: dict[str, Any], binary: bytes, path: Path) -> bytes:
    """Pack JSON and buffer into the binary container (glTF 2.0, section 4.4)."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    if length > MAX_GLB_BYTES:
        raise F4xError(f"{path}: {length >> 30} GiB do not fit into a .glb file; export PLY, or fewer Gaussians")
    return b"".join(
        [
            GLB_MAGIC + struct.pack("<II", 2, length),
            struct.pack("<I", len(text)) + JSON_CHUNK + text,
            struct.pack("<I", len(binary)) + BIN_CHUNK + binary,
        ]
    )
