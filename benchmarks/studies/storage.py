"""Storage against error: megabytes of a scene in several precisions, and how far its pictures are then off."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scaffold.skinning import skinning_weights
from f4x_core.scene import DynamicSet, Scene, StaticSet, write_scene
from f4x_core.scene.field import FeatureField, quantise
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export
from f4x_core.scene.model import DYNAMIC_ARRAYS, GAUSSIAN_ARRAYS, SCAFFOLD_ARRAYS
from f4x_core.scene.view import render

from ..speed.raster import make_wavy_scene
from ..study import Context, Figure, Findings, Row, Table

SIZES = (6000, 192, 108), (50_000, 480, 270)
"""Gaussians and pixels of a quick and of a full report."""
FRAMES, NODES, SLOTS, DEGREE, LATENT = 24, 60, 4, 1, 32
"""Of the made-up scene; most fits end at degree 1."""
PAPER_MB = {"MoSca": 67.726, "MoSca + Feature 3DGS": 593.907, "Feature4X, one head": 95.294, "Feature4X, full": 95.457}
"""Feature4X, supplement, Table B: mean size (MB) of the 7 scenes from the NVIDIA data set."""
MEGABYTE = 1e6
TIMES = (0.0, 11.5, 23.0)
"""Moments whose pictures are compared, one of them between frames."""
FINE_DB = 40.0
"""Two pictures that are closer hardly differ to the eye."""
LATENT_WIDE = 512
"""Channels of the teachers that Feature 3DGS stores on every Gaussian."""
RMSE, PSNR, SIZE = "picture rmse", "PSNR (dB)", "size (MB)"

Codec = Callable[[np.ndarray], tuple[np.ndarray, float]]
"""Array of floats -> (what reading gives back, bytes that it takes)."""


def as_float(kind: type[np.floating[Any]], values: np.ndarray) -> tuple[np.ndarray, float]:
    """Plain floats."""
    stored = values.astype(kind)
    return stored.astype(np.float32), stored.nbytes


def as_steps(bits: int, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Equal steps between the least and the largest value of each column, whose two ends take 8 bytes."""
    columns = values.reshape(-1, values.shape[-1]) if values.ndim > 1 else values[:, None]
    low, high = columns.min(0), columns.max(0)
    step = np.maximum((high - low) / (2**bits - 1), np.finfo(np.float32).tiny)
    back = low + step * np.rint((columns - low) / step)
    return back.reshape(values.shape).astype(np.float32), columns.size * bits / 8 + 8 * columns.shape[1]


def in_logarithms(codec: Codec, values: np.ndarray) -> tuple[np.ndarray, float]:
    """`codec` of the logarithms: sizes span decades."""
    logs, size = codec(np.log(np.maximum(values, 1e-12)))
    return np.exp(logs), size


def as_fractions(codec: Codec, values: np.ndarray) -> tuple[np.ndarray, float]:
    """`codec`, then rows that sum to 1 again."""
    back, size = codec(values)
    return back / back.sum(1, keepdims=True), size


def _directly(codec: Codec, values: np.ndarray) -> tuple[np.ndarray, float]:
    return codec(values)


CAREFUL = {"scales": in_logarithms, "weight": as_fractions}
"""Arrays that aren't encoded as they are."""
FLOAT32, FLOAT16 = partial(as_float, np.float32), partial(as_float, np.float16)
STEPS = {bits: partial(as_steps, bits) for bits in (16, 8, 6, 4)}
CODECS: dict[tuple[str, int], Codec] = {("float16", 16): FLOAT16} | {("steps", n): codec for n, codec in STEPS.items()}
POSITIONS = ("static/xyz", "dynamic/xyz", "scaffold/xyz")


@dataclass(frozen=True)
class Encoding:
    """Encoding of the floats of a scene."""

    name: str
    usual: Codec
    positions: Codec


ENCODINGS = (
    Encoding("float32, the scene file", FLOAT32, FLOAT32),
    Encoding("float16, positions float32", FLOAT16, FLOAT32),
    Encoding("float16", FLOAT16, FLOAT16),
    Encoding("16 bits", STEPS[16], STEPS[16]),
    Encoding("8 bits, positions float32", STEPS[8], FLOAT32),
    Encoding("8 bits, positions 16", STEPS[8], STEPS[16]),
    Encoding("8 bits", STEPS[8], STEPS[8]),
    Encoding("6 bits, positions 16", STEPS[6], STEPS[16]),
    Encoding("4 bits, positions 16", STEPS[4], STEPS[16]),
)


def measure_storage(context: Context) -> Findings:
    """Sizes and pictures of one scene: all arrays alike, one array at a time, other programs' formats, features."""
    count, width, height = context.choose(*SIZES)
    scene = make_scene(count, width, height, context.seed)
    file = context.folder / "scene.f4x"
    write_scene(scene, file)
    about = {"count": count, "width": width}
    rows = context.step("encodings", partial(_encoding_rows, scene), **about)
    single = context.step("single-arrays", partial(_single_rows, scene), **about)
    formats = context.step("formats", partial(_format_rows, scene, context), **about)
    features = context.step("features", partial(_feature_rows, scene, context.seed), **about)
    size = f"{len(scene.ids):,} Gaussians, {len(scene.dynamic):,} moving, degree {DEGREE}, {width} x {height} pixels"
    tables = [
        Table("encodings", rows, f"Every float alike: {size}", note=_ENCODINGS_NOTE),
        Table("single-arrays", single, "One array at a time, the others float32", note="What needs its precision."),
        Table("formats", formats, "One moment in the formats of other programs", note=_FORMATS_NOTE),
        Table("features", features, "With features, beside Table B", note=_FEATURES_NOTE),
    ]
    figures = [
        Figure("All arrays alike", "encodings", SIZE, RMSE, "name", log="y"),
        Figure("One array at a time", "single-arrays", "bits", RMSE, "array", log="y", where={"stored": "steps"}),
    ]
    words = [_encoding_words(rows), _single_words(single), _feature_words(features)]
    words.append(
        f"The scene file itself has {file.stat().st_size / MEGABYTE:.2f} MB, {rows[0][SIZE]:.2f} MB of them arrays."
    )
    return Findings(tables, figures, words)


_ENCODINGS_NOTE = (
    "The scene is made up (wavy sheets with smooth and noisy colours; the front one moves): sizes and errors of fitted ones differ."
    " Scene files hold float32; the others are what a user could store. `bits`: equal steps between the ends of each"
    " column, scales by their logarithm; ids and indices stay as they are. Errors are those of pictures at"
    f" {len(TIMES)} moments against the float32 scene."
)
_FORMATS_NOTE = (
    "Written by `f4x export` and read back. A .splat holds no view-dependent colour, and rotations in 8 bits."
)
_FEATURES_NOTE = (
    "Ours: bytes of this scene's arrays; the latent is smooth and made up. Theirs: mean of 7 other scenes. `ratio`: over the scene"
    " without features (theirs: over MoSca). A row of 512 channels on every Gaussian is what storing the features themselves takes."
)


def make_scene(count: int, width: int, height: int, seed: int) -> Scene:
    """Wavy sheets of `count` Gaussians, the front one carried by nodes that turn and shift over `FRAMES` frames."""
    wavy = make_wavy_scene(count, 3, width, height, seed)
    arrays = {name: value.numpy() for name, value in wavy.items() if name not in ("width", "height")}
    rng = np.random.default_rng(seed)
    x = arrays["means"]
    smooth = 0.5 + 0.35 * np.sin(6 * x + [0, 2, 4])  # (N,3)
    sh = 0.05 * rng.normal(size=(count, (DEGREE + 1) ** 2, 3))
    sh[:, 0] = spherical_harmonics.dc_from_rgb(0.8 * smooth + 0.2 * arrays["colors"])
    whole = {
        "ids": np.arange(count),
        "means": x,
        "quats": quaternion.normalize(arrays["quats"]),
        "scales": arrays["scales"],
        "opacities": arrays["opacities"],
        "sh": sh.astype(np.float32),
    }
    front = np.arange(count) % 6 == 0  # the first sheet of the wavy scene
    scaffold, carried = _carried(x[front], rng)
    cameras = CameraPath(
        np.tile(arrays["K"].astype(float), (FRAMES, 1, 1)),
        np.tile(arrays["viewmat"].astype(float), (FRAMES, 1, 1)),
        np.arange(FRAMES, dtype=float),
        width,
        height,
    )
    static = StaticSet(**{name: value[~front] for name, value in whole.items()})
    dynamic = DynamicSet(**{name: value[front] for name, value in whole.items()}, **carried)
    return Scene("wavy", static, cameras, dynamic, scaffold)


def _carried(x: np.ndarray, rng: np.random.Generator) -> tuple[Scaffold, dict[str, np.ndarray]]:
    """Nodes among the points `x (n,3)`, and what says who carries them."""
    from scipy.spatial import cKDTree

    nodes = x[rng.choice(len(x), min(NODES, len(x)), replace=False)]
    count = len(nodes)
    phase = np.linspace(0, 1, FRAMES)[:, None, None]
    xyz = nodes + 0.1 * np.sin(3 * phase + nodes[None])
    turn = 0.4 * phase * np.sin(5 * nodes[None] + [0, 1, 2])
    _, own = cKDTree(nodes).query(nodes, min(SLOTS, count))
    radius = np.full(count, 0.1, np.float32)
    scaffold = Scaffold(
        times=np.arange(FRAMES, dtype=float),
        xyz=xyz.astype(np.float32),
        quat=quaternion.from_rotation_vector(turn).astype(np.float32),
        radius=radius,
        certain=np.ones((FRAMES, count), bool),
        ids=np.arange(count),
        neighbours=own,
        edge_mask=np.ones(own.shape, bool),
        unit=0.1,
    )
    _, node = cKDTree(xyz[0]).query(x, min(SLOTS, count))
    weight, _ = skinning_weights(x, xyz[0][node].astype(np.float32), radius[node], np.ones(node.shape, bool))
    return scaffold, {
        "reference": np.zeros(len(x), np.int32),
        "node": node.astype(np.int32),
        "weight": weight.astype(np.float32),
        "strength": np.ones(len(x), np.float32),
    }


def encode(scene: Scene, codec_of: Mapping[str, Codec], usual: Codec) -> tuple[Scene, float]:
    """Return the scene as it comes back, and its bytes; `codec_of` by `part/array`, `usual` for the other floats."""
    parts, total = {}, 0.0
    for part, layout in (("static", GAUSSIAN_ARRAYS), ("dynamic", DYNAMIC_ARRAYS), ("scaffold", SCAFFOLD_ARRAYS)):
        old = getattr(scene, part)
        changed = {}
        for name in layout:
            array = getattr(old, name)
            if layout[name][0] != "<f4":
                total += array.nbytes
                continue
            codec = codec_of.get(f"{part}/{name}", usual)
            changed[name], size = codec(array) if codec is FLOAT32 else CAREFUL.get(name, _directly)(codec, array)
            total += size
        parts[part] = replace(old, **changed)
    return replace(scene, **parts), total


def _images(scene: Scene, times: Sequence[float] = TIMES) -> np.ndarray:
    """Return (T,H,W,3) float64 in [0,1]."""
    drawn = [render(scene, scene.cameras[int(time)], time, ("rgb",))["rgb"] for time in times]
    return np.clip(np.stack(drawn), 0, 1).astype(np.float64)


def _off(images: np.ndarray, truth: np.ndarray) -> Row:
    rmse = float(np.sqrt(np.mean((images - truth) ** 2)))
    return {RMSE: rmse, PSNR: -20 * math.log10(rmse) if rmse else None}


def _encoding_rows(scene: Scene) -> list[Row]:
    truth = _images(scene)
    rows = []
    for encoding in ENCODINGS:
        back, size = encode(scene, dict.fromkeys(POSITIONS, encoding.positions), encoding.usual)
        row: Row = {"name": encoding.name, SIZE: size / MEGABYTE}
        rows.append(row | {"share": None} | _off(_images(back), truth))
    return [row | {"share": row[SIZE] / rows[0][SIZE]} for row in rows]


def _single_rows(scene: Scene) -> list[Row]:
    truth = _images(scene)
    names = [
        f"{part}/{name}" for part in ("static", "dynamic") for name in ("means", "quats", "scales", "opacities", "sh")
    ]
    names += ["dynamic/weight", "scaffold/xyz", "scaffold/quat"]
    return [
        {"array": name, "stored": kind, "bits": bits} | _off(_images(encode(scene, {name: codec}, FLOAT32)[0]), truth)
        for name in names
        for (kind, bits), codec in CODECS.items()
    ]


def _format_rows(scene: Scene, context: Context) -> list[Row]:
    truth = _images(scene, TIMES[:1])
    rows: list[Row] = [
        {"format": "none: the moment's own float32", SIZE: _moment_bytes(scene) / MEGABYTE} | _off(truth, truth)
    ]
    for name, file in (("ply", "moment.ply"), ("splat", "moment.splat")):
        (path,) = export(scene, context.folder / file, TIMES[:1], name).files
        back = open_any(path, sequence=False)
        assert isinstance(back, Scene)
        back = replace(back, cameras=scene.cameras)
        rows.append({"format": name, SIZE: path.stat().st_size / MEGABYTE} | _off(_images(back, TIMES[:1]), truth))
        path.unlink()
    return rows


def _moment_bytes(scene: Scene) -> int:
    posed = scene.posed(TIMES[0])
    return sum(array.nbytes for array in (posed.means, posed.quats, posed.scales, posed.opacities, posed.sh))


def _feature_rows(scene: Scene, seed: int) -> list[Row]:
    assert scene.scaffold is not None
    rng = np.random.default_rng(seed)
    waves = 4 * rng.normal(size=(3, LATENT))
    static, nodes = (np.sin(x @ waves).astype(np.float32) for x in (scene.static.means, scene.scaffold.xyz[0]))
    still, moving = (
        _bytes(part, layout) for part, layout in ((scene.static, GAUSSIAN_ARRAYS), (scene.dynamic, DYNAMIC_ARRAYS))
    )
    moving += _bytes(scene.scaffold, SCAFFOLD_ARRAYS)
    dynamic = scene.dynamic
    truth = _latents(static, nodes, dynamic)
    wide = LATENT_WIDE * 4
    sizes: dict[str, tuple[float, float, float | None]] = {
        "no features": (0, 0, None),
        f"{LATENT} channels, float32": (static.nbytes, nodes.nbytes, 0.0),
    }
    for bits in (8, 4):
        stored = quantise(static, nodes, bits)
        field = FeatureField(*stored, bits=bits)
        found = field.latents(dynamic.node, dynamic.weight)
        packed = field.to_arrays()
        error = float(np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2)))
        name = f"{LATENT} channels, {bits} bits (the scene file)"
        sizes[name] = (packed["static/latent"].nbytes, packed["scaffold/latent"].nbytes, error)
    sizes[f"{LATENT_WIDE} channels on every Gaussian"] = (len(static) * wide, len(dynamic) * wide, None)
    plain = (still + moving) / MEGABYTE
    rows: list[Row] = []
    for name, (more_still, more_moving, off) in sizes.items():
        total = (still + moving + more_still + more_moving) / MEGABYTE
        row: Row = {"source": "ours", "scene": name, "static (MB)": (still + more_still) / MEGABYTE}
        row |= {"dynamic (MB)": (moving + more_moving) / MEGABYTE, SIZE: total, "ratio": total / plain}
        rows.append(row | {"relative error of latents": off})
    theirs = PAPER_MB["MoSca"]
    return rows + [
        {"source": "Feature4X, Table B", "scene": name, SIZE: size, "ratio": size / theirs}
        for name, size in PAPER_MB.items()
    ]


def _latents(static: np.ndarray, nodes: np.ndarray, dynamic: DynamicSet) -> np.ndarray:
    """Return (N,D) float64 before they are stored."""
    blended = (dynamic.weight[..., None].astype(np.float64) * nodes[dynamic.node]).sum(1)
    return np.concatenate([static, blended])


def _bytes(part: Any, layout: Mapping[str, Any]) -> int:
    return sum(getattr(part, f.name).nbytes for f in fields(part) if f.name in layout)


def _encoding_words(rows: Sequence[Row]) -> str:
    fine = [row for row in rows[1:] if row[PSNR] is None or row[PSNR] >= FINE_DB]
    if not fine:
        return f"No smaller encoding keeps {FINE_DB:.0f} dB against the pictures of the float32 scene."
    best = min(fine, key=lambda row: row[SIZE])
    return (
        f"The smallest encoding that keeps {FINE_DB:.0f} dB against the pictures of the float32 scene is '{best['name']}':"
        f" {best['share']:.0%} of the bytes at {best[PSNR]:.1f} dB."
    )


def _single_words(rows: Sequence[Row]) -> str:
    coarse = sorted((row for row in rows if (row["stored"], row["bits"]) == ("steps", 8)), key=lambda row: -row[RMSE])
    return (
        f"Of arrays in 8 bits, {coarse[0]['array']} costs most ({coarse[0][PSNR]:.1f} dB), then {coarse[1]['array']}"
        f" ({coarse[1][PSNR]:.1f} dB)."
    )


def _feature_words(rows: Sequence[Row]) -> str:
    ours = {row["scene"]: row for row in rows if row["source"] == "ours"}
    eight = ours[f"{LATENT} channels, 8 bits (the scene file)"]
    plain = ours[f"{LATENT} channels, float32"]
    wide = ours[f"{LATENT_WIDE} channels on every Gaussian"]
    theirs = {row["scene"]: row["ratio"] for row in rows if row["source"] != "ours"}
    return (
        f"A latent of {LATENT} channels makes this scene {plain['ratio']:.2f} times as large in float32, as"
        f" checkpoints usually are (theirs: {theirs['Feature4X, full']:.2f}), and {eight['ratio']:.2f} times in the 8 bits of the"
        f" scene file, beside float32 Gaussians; {LATENT_WIDE} channels on every Gaussian {wide['ratio']:.1f} times (theirs:"
        f" {theirs['MoSca + Feature 3DGS']:.2f})."
    )
