"""Animated `.usda`, or `.usdc` where OpenUSD's library is there, for splats or points.

Splats are `ParticleField3DGaussianSplat` (OpenUSD 26.03 and later), points `Points` for older readers.

Text, so that no USD library is needed; a number has no more digits than a picture can show, and each Gaussian is described in
those of its axes whose quaternions are the shortest text (the Gaussian is the same). Gaussians that stay as they are
over all written times form the prim `static`, the others `dynamic`; an attribute has time samples only where it changes. Time
codes are clip frames. The stage is y up: data are turned on the way out, harmonics too, because renderers do not turn those
with the prim.
"""

from __future__ import annotations

import itertools
import math
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import IO

import numpy as np

from ...errors import F4xError
from ...files import replace_file, replace_path
from ...geometry import quaternion, spherical_harmonics
from ...progress import Progress, silent
from ..color import linear_from_srgb
from ..linear import footprint, with_footprint
from ..model import PosedSplats
from ..ply import MIN_SCALE
from ..posing import Y_UP, Posable, plain_color, transformed, world_harmonics
from ..tints import without_tints

FIELDS = ("means", "quats", "scales", "opacities", "sh")
"""Fields of `PosedSplats` that may change with time."""
HARMONICS = "harmonics"
"""Beside them: coefficients in world axes, which also change when the Gaussian turns."""
MAX_DEGREE = 3
"""Validators of the schema refuse more."""
REACH = 3.0
"""Standard deviations that the bounding box leaves around a centre: where viewers cut a splat off."""
FINE = 1 / 100
"""Positions are rounded to this part of a Gaussian's size (median of the largest standard deviations), or less: a decimal."""
MIN_DECIMALS = 5
"""Minimum decimals of a position, for any size of Gaussians: one fewer lets flat ones on a surface swap their order."""
DECIMALS = 3
"""Decimals of a quaternion's component (0.03 degrees), an opacity and a coefficient, whose colours end as 8 bits."""
LINEAR_DECIMALS = 4
"""Decimals of a colour in linear light, whose dark tones are 13 times closer to each other."""
SIZE_DIGITS = 3
"""Significant digits of a size: half a hundredth at most."""
EXACT = 9
"""Significant digits that tell all float32 numbers apart."""
TURNS = quaternion.normalize(
    np.array([q for q in itertools.product((-1.0, 0, 1), repeat=4) if np.count_nonzero(q) in (1, 2, 4)])
)
"""(48,4) quaternions wxyz of the 24 rotations, twice each, that take the axes to each other: an ellipsoid described in axes that
are turned like this is the same with its sizes in another order."""
AROUND = 3
"""Characters that a number takes besides its decimals: sign or digit, point, comma."""
ROWS = 8192
"""Rows turned into text at once."""


@dataclass(frozen=True)
class Column:
    """Attribute of a prim."""

    declaration: str
    """Type and name."""
    fields: tuple[str, ...]
    """Names from `FIELDS` and `HARMONICS`: the attribute changes when one of them does."""
    values: Callable[[PosedSplats], np.ndarray]
    """(N,) or (N,k) numbers."""
    decimals: int | None = DECIMALS
    """Decimals of each number; None = those of the part's positions."""
    digits: int | None = None
    """Significant digits of each number, in place of `decimals`."""
    metadata: Callable[[int], str] = lambda coefficients: ""
    """Metadata in parentheses, given the number of SH coefficients."""


@dataclass(frozen=True)
class Kind:
    """A prim type and its attributes."""

    type_name: str
    """Type of the prim in its schema."""
    columns: tuple[Column, ...]
    """Attributes that are written for each Gaussian."""
    fixed: Callable[[int], tuple[str, ...]]
    """Attributes without a value per Gaussian, given the number of SH coefficients."""


def _harmonics(posed: PosedSplats) -> np.ndarray:
    """Return (N S, 3): the coefficients of one Gaussian are neighbours, the constant one first."""
    return world_harmonics(posed, MAX_DEGREE).reshape(-1, 3)


SPLATS = Kind(
    "ParticleField3DGaussianSplat",
    (
        Column("point3f[] positions", ("means",), lambda posed: posed.means, None),
        Column("quatf[] orientations", ("quats",), lambda posed: posed.quats),
        Column("float3[] scales", ("scales",), lambda posed: np.maximum(posed.scales, MIN_SCALE), digits=SIZE_DIGITS),
        Column("float[] opacities", ("opacities",), lambda posed: posed.opacities),
        Column(
            "float3[] radiance:sphericalHarmonicsCoefficients",
            ("sh", HARMONICS),
            _harmonics,
            metadata=lambda coefficients: f' (elementSize = {coefficients}; interpolation = "vertex")',
        ),
    ),
    lambda coefficients: (
        f"uniform int radiance:sphericalHarmonicsDegree = {spherical_harmonics.degree_of(coefficients)}",
        'uniform token projectionModeHint = "perspective"',
        'uniform token sortingModeHint = "zDepth"',
    ),
)
POINTS = Kind(
    "Points",
    (
        Column("point3f[] points", ("means",), lambda posed: posed.means, None),
        # A sphere of one standard deviation; the width is its diameter.
        Column("float[] widths", ("scales",), lambda posed: 2 * np.cbrt(posed.scales.prod(axis=1)), digits=SIZE_DIGITS),
        Column(
            "color3f[] primvars:displayColor",
            ("sh",),
            lambda posed: linear_from_srgb(plain_color(posed)),
            LINEAR_DECIMALS,
            metadata=lambda _: ' (interpolation = "vertex")',
        ),
        Column(
            "float[] primvars:displayOpacity",
            ("opacities",),
            lambda posed: posed.opacities,
            metadata=lambda _: ' (interpolation = "vertex")',
        ),
    ),
    lambda _: (),
)


def expected_bytes(static: int, dynamic: int, moments: int, coefficients: int) -> int:
    """Return about the size of the file that `write_usd` makes of so many Gaussians at so many moments; `dynamic` move."""
    shape = DECIMALS + AROUND
    colour = 3 * min(coefficients, (MAX_DEGREE + 1) ** 2) * shape
    pose = 3 * (MIN_DECIMALS + AROUND) + 4 * shape
    # coefficients turn with the Gaussian, but for the constant one
    sampled = pose + (colour if coefficients > 1 else 0)
    return static * (pose + 4 * shape + colour) + dynamic * (moments * sampled + 4 * shape + colour)


def write_usd(
    scene: Posable,
    times: Sequence[float],
    path: Path | str,
    transform: np.ndarray | None = None,
    progress: Progress = silent,
    kind: Kind = SPLATS,
) -> None:
    """Write splats at all `times` (clip times, increasing), moved by the 4x4 similarity `transform`.

    A `path` that ends in .usdc gets OpenUSD's binary form of the same. Raises F4xError, also where that lacks its library.
    """
    if Path(path).suffix.lower() == ".usdc":
        _write_binary(Path(path), lambda text: write_usd(scene, times, text, transform, progress, kind))
        return
    matrix = Y_UP if transform is None else Y_UP @ np.asarray(transform, np.float64)
    scene = without_tints(scene)
    moments = _Moments(scene, times, matrix, footprint(scene) if kind is SPLATS else None)
    parts, coefficients = _parts(iter(moments), path)
    root = re.sub(r"\W", "_", scene.name, flags=re.ASCII)
    root = root if re.match(r"[A-Za-z_]", root) else f"_{root}"
    if not parts:
        raise F4xError(f"{path}: nothing is visible at the chosen times; choose others")
    done, total = itertools.count(), len(times) * sum(part.samples(column) for part in parts for column in kind.columns)
    with replace_file(path) as file:
        file.write(_header(root, times, scene.fps, Y_UP[:3, :3] @ scene.offset).encode())
        for part in parts:
            _write_part(
                file, part, kind, coefficients, moments, lambda message: progress("export", next(done), total, message)
            )
        file.write(b"}\n")
    progress("export", total, total)


write_usd_points = partial(write_usd, kind=POINTS)
"""`write_usd` of coloured points, which any USD reader shows and Blender plays back as a point cloud."""


@dataclass(frozen=True, eq=False)
class Part:
    """Gaussians that become one prim."""

    name: str
    index: np.ndarray | None
    """Into `PosedSplats`; None where their number changes with time: all that are visible."""
    extent: tuple[np.ndarray, np.ndarray]
    """Corners (3,) of the box that holds them at all times."""
    varying: frozenset[str]
    """Names from `FIELDS` and `HARMONICS` that change with time."""
    decimals: int
    """Decimals of positions."""

    def text(self, column: Column, posed: PosedSplats) -> bytes:
        """Return the values of an attribute at one moment."""
        decimals = self.decimals if column.decimals is None else column.decimals
        return _array(column.values(self.of(posed)), decimals, column.digits)

    def samples(self, column: Column) -> bool:
        """Return True if the attribute needs time samples."""
        return not self.varying.isdisjoint(column.fields)

    def of(self, posed: PosedSplats) -> PosedSplats:
        """Return the part's Gaussians of a moment."""
        return posed.take(posed.opacities > 0 if self.index is None else self.index)


@dataclass(frozen=True, eq=False)
class _Moments:
    """A scene at clip times, in the axes of a stage."""

    scene: Posable
    """Without tints: with them every Gaussian has colors of its own in every frame."""
    times: Sequence[float]
    """Increasing."""
    matrix: np.ndarray
    """(4,4) similarity from the scene to the stage."""
    footprint: np.ndarray | None
    """(N,) standard deviation that is added to all scales; None: none is."""

    def at(self, time: float) -> PosedSplats:
        """Return the Gaussians at one moment."""
        posed = self.scene.posed(time)
        return transformed(posed if self.footprint is None else with_footprint(posed, self.footprint), self.matrix)

    @cached_property
    def turns(self) -> np.ndarray:
        """(N,) rows of `TURNS` that shorten the text of the quaternions."""
        times = self.times
        return _shortest_turns([self.at(time).quats for time in (times[0], times[len(times) // 2], times[-1])])

    def __iter__(self) -> Iterator[PosedSplats]:
        """Yield the moments in order; neighbouring quaternions on one hemisphere, because readers interpolate them."""
        before = np.empty((0, 4))
        for time in self.times:
            posed = self.at(time)
            if len(self.turns) == len(posed.quats):  # else their number changes with time
                posed = _turned(posed, self.turns)
            quats = quaternion.normalize(posed.quats)
            if before.shape == quats.shape:
                quats = np.where((before * quats).sum(axis=1, keepdims=True) < 0, -quats, quats)
            before = quats
            yield replace(posed, quats=quats)


def _counted(moments: _Moments, report: Callable[[], None]) -> Iterator[PosedSplats]:
    """Yield the moments, with a call of `report` before each."""
    for posed in moments:
        report()
        yield posed


def _write_part(
    file: IO[bytes], part: Part, kind: Kind, coefficients: int, moments: _Moments, report: Callable[[str], None]
) -> None:
    """Write one prim of splats; `report` is called with a message for every moment of an attribute."""
    low, high = part.extent
    file.write(f'\n    def {kind.type_name} "{part.name}"\n    {{\n'.encode())
    file.write(b"        float3[] extent = " + _array(np.stack([low, high]), part.decimals) + b"\n")
    file.write("".join(f"        {line}\n" for line in kind.fixed(coefficients)).encode())
    for column in kind.columns:
        metadata = column.metadata(coefficients).encode()
        if not part.samples(column):
            text = part.text(column, next(iter(moments)))
            file.write(f"        {column.declaration} = ".encode() + text + metadata + b"\n")
            continue
        if metadata:  # metadata stand with a declaration, time samples follow alone
            file.write(f"        {column.declaration}".encode() + metadata + b"\n")
        file.write(f"        {column.declaration}.timeSamples = {{\n".encode())
        counted = _counted(moments, partial(report, f"{part.name} {column.declaration.split()[1]}"))
        for time, text in _samples(moments.times, (part.text(column, posed) for posed in counted)):
            file.write(f"            {time:.10g}: ".encode() + text + b",\n")
        file.write(b"        }\n")
    file.write(b"    }\n")


def _shortest_turns(moments: Sequence[np.ndarray]) -> np.ndarray:
    """Return rows (N,) of `TURNS` after which the quaternions (N,4) of some moments take the fewest characters.

    Those of the first moment alone count where their number changes.
    """
    same = [quats for quats in moments if len(quats) == len(moments[0])]
    aligned = quaternion.align_sequence(quaternion.normalize(np.stack(same)))
    return np.argmin([_characters(quaternion.multiply(aligned, turn)).sum(axis=0) for turn in TURNS], axis=0)


def _characters(quats: np.ndarray) -> np.ndarray:
    """Return the number of characters (...) of the four numbers of unit quaternions (...,4), without separators."""
    rounded = np.round(quats * 10**DECIMALS)
    zeros = sum((rounded % 10**count == 0).astype(np.int16) for count in range(1, DECIMALS))  # at its end
    whole = rounded % 10**DECIMALS == 0
    return (np.where(whole, 1, 1 + DECIMALS - zeros) + (rounded < 0)).sum(axis=-1)


def _turned(posed: PosedSplats, turns: np.ndarray) -> PosedSplats:
    """Return the same Gaussians in axes turned by rows (N,) of `TURNS`."""
    order = np.abs(quaternion.to_matrix(TURNS)).argmax(axis=1)  # (48,3): which old axis each new one is
    sh = posed.sh
    if sh.shape[1] > 1:  # they are in the Gaussian's own axes
        sh = spherical_harmonics.rotate(sh, quaternion.conjugate(TURNS[turns]).astype(sh.dtype))
    return replace(
        posed,
        quats=quaternion.multiply(quaternion.normalize(posed.quats), TURNS[turns]),
        scales=np.take_along_axis(posed.scales, order[turns], axis=1),
        sh=sh,
    )


def _write_binary(path: Path, write_text: Callable[[Path], None]) -> None:
    """Let `write_text` write a .usda beside `path`, and turn that into the .usdc at `path`."""
    try:
        from pxr import Sdf
    except ImportError as error:
        raise F4xError(
            f"{path}: the binary form is written by OpenUSD's library (pip install usd-core); name it .usda for text."
        ) from error
    with replace_path(path, ".usdc") as binary, tempfile.TemporaryDirectory(dir=path.parent, prefix=".f4x_") as folder:
        text = Path(folder) / "stage.usda"
        write_text(text)
        if not Sdf.Layer.FindOrOpen(str(text)).Export(str(binary)):
            raise F4xError(f"{path}: OpenUSD could not write it; check the free space.")


def _samples(times: Sequence[float], texts: Iterator[bytes]) -> Iterator[tuple[float, bytes]]:
    """Yield the moments to write: of several with the same text in a row the first and the last.

    Readers interpolate between samples, and nothing changes after the last one.
    """
    shown, held = b"", None
    for time, text in zip(times, texts, strict=True):
        if text == shown:
            held = time
            continue
        if held is not None:
            yield held, shown
        yield time, text
        shown, held = text, None


def _parts(poses: Iterator[PosedSplats], path: Path | str) -> tuple[list[Part], int]:
    """Return the prims, and the number of SH coefficients that are written.

    Where the number of Gaussians changes, as in a sequence of separately trained frames, all are one sampled prim.
    """
    first = next(poses)
    low, high = _boxes(first)
    moving, seen = np.zeros(len(first.ids), bool), first.opacities > 0
    varying: set[str] = set()
    steady = True
    for posed in poses:
        if posed.sh.shape[1] != first.sh.shape[1]:
            raise F4xError(f"{path}: the degree of the harmonics changes with time, which USD cannot hold; export PLY")
        below, above = _boxes(posed)
        steady = steady and np.array_equal(posed.ids, first.ids)
        if not steady:
            low = np.concatenate([low, below]).min(axis=0, keepdims=True, initial=np.inf)
            high = np.concatenate([high, above]).max(axis=0, keepdims=True, initial=-np.inf)
            continue
        low, high = np.minimum(low, below), np.maximum(high, above)
        seen |= posed.opacities > 0
        for name in FIELDS:
            now, then = getattr(posed, name), getattr(first, name)
            changed = (now != then).reshape(len(now), -1).any(axis=1)
            if changed.any():
                varying.add(name)
                moving |= changed
    coefficients = min(first.sh.shape[1], (MAX_DEGREE + 1) ** 2)
    if not steady:
        return [
            Part("dynamic", None, (low[0], high[0]), frozenset({*FIELDS, HARMONICS}), _decimals(first))
        ], coefficients
    if coefficients > 1 and "quats" in varying:
        varying.add(HARMONICS)
    prims = {"static": (seen & ~moving, frozenset[str]()), "dynamic": (seen & moving, frozenset(varying))}
    return [
        Part(
            name,
            np.flatnonzero(mask),
            (low[mask].min(axis=0), high[mask].max(axis=0)),
            fields,
            _decimals(first.take(mask)),
        )
        for name, (mask, fields) in prims.items()
        if mask.any()
    ], coefficients


def _boxes(posed: PosedSplats) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (N,3) of a box around each Gaussian."""
    reach = REACH * posed.scales.max(axis=1, keepdims=True, initial=0)
    return posed.means - reach, posed.means + reach


def _header(root: str, times: Sequence[float], fps: float, offset: np.ndarray) -> str:
    """Return the lines up to the first prim of splats; `offset (3,)` moves all of them, in double precision."""
    moved = f"({', '.join(f'{value:.17g}' for value in offset)})"
    shift = (
        f'    double3 xformOp:translate = {moved}\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n'
        if offset.any()
        else ""
    )
    return (
        "#usda 1.0\n(\n"
        f'    defaultPrim = "{root}"\n'
        '    doc = "Made by Feature4X for Blender. Time codes are clip frames; the unit is the median depth of the clip."\n'
        f"    startTimeCode = {times[0]:.10g}\n    endTimeCode = {times[-1]:.10g}\n"
        f"    timeCodesPerSecond = {fps:.10g}\n    framesPerSecond = {fps:.10g}\n"
        '    metersPerUnit = 1\n    upAxis = "Y"\n)\n\n'
        f'def Xform "{root}"\n{{\n{shift}'
    )


def _decimals(posed: PosedSplats) -> int:
    """Return the number of decimals that positions of Gaussians of this size need."""
    size = max(float(np.median(posed.scales.max(axis=1))), MIN_SCALE)
    return max(MIN_DECIMALS, math.ceil(-math.log10(FINE * size)))


def _array(values: np.ndarray, decimals: int, digits: int | None = None) -> bytes:
    """Return `[1,2]` of values (N,), `[(1,2),(.3,4)]` of (N,k), rounded to `decimals`, or to significant `digits`."""
    if digits is None:
        digits, values = EXACT, np.round(values.astype(np.float64), decimals) + 0.0  # there is no -0 then
    number = f"%.{digits}g"
    row = number if values.ndim == 1 else f"({','.join([number] * values.shape[1])})"
    parts = []
    for start in range(0, len(values), ROWS):
        part = values[start : start + ROWS]
        text = ("," if start else "[") + ",".join([row] * len(part)) % tuple(part.ravel().tolist())
        for before in "[(,-":
            text = text.replace(f"{before}0.", f"{before}.")
        parts.append(text.encode("ascii"))
    return b"".join([*parts, b"]"])
