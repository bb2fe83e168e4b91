"""SPZ: Niantic's compressed splats, versions 2 and 3 (github.com/nianticlabs/spz, README).

A gzip stream: a header of 16 bytes, then by attribute positions in 24-bit fixed point, opacity, colour, log scale, rotation and
harmonics in 8 bits (rotation in 32: the smallest three components). Axes x right, y up, z backward.
"""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import F4xError
from ...files import replace_file
from ...geometry import quaternion, spherical_harmonics
from ...geometry.splats import Splats
from ...language.lexicon import plural
from ...reading import OWN_LIMIT, require_inflation
from ..posing import Y_UP, Posable, moment, similarity_of, world_harmonics

HEADER = np.dtype([("magic", "<u4"), ("version", "<u4"), ("count", "<u4"), ("numbers", "u1", 4)])
"""`numbers`: degree of the harmonics, fractional bits of a position, flags, nothing."""
MAGIC = 0x5053474E
VERSION = 3
"""Written; 2, with rotations in 24 bits, is read too."""
MAX_POINTS = 10_000_000
"""Limit of Niantic's own reader."""
VERSIONS = (2, 3)
"""Read; version 4 is no gzip stream."""
MAX_FRACTION = 20
"""Fractional bits of a position at most: a millionth of the unit, finer than float32 at the unit itself."""
POSITION_BITS = 24
FIXED = (1 << (POSITION_BITS - 1)) - 1
"""Largest 24-bit signed number."""
FINE = 1 / 100
"""A step of a position is at most this part of a typical Gaussian's size, where far outliers would make it coarser."""
BULK = 0.99
"""Fraction of the Gaussians whose positions are never clamped for that."""
ROW_BLOCK = 1 << 18
"""Splats that are unpacked at once."""
COLOUR_SCALE = 0.15
"""Scale of a degree-0 coefficient: bytes span +-3.3, which covers colours somewhat outside [0, 1]."""
SCALE_STEPS, SCALE_ORIGIN = 16, 10
"""A byte of scale is `16 (log scale + 10)`: 6 % a step, from 4.5e-5 to 380."""
COMPONENT = 511
"""Largest magnitude of a rotation's component, which stands for sqrt(1/2)."""
HARMONICS_STEP = (8, 16)
"""A harmonic's byte is `128 + 128 h` rounded to a multiple of these at degree 1 and above, so that gzip has less to keep."""


@dataclass(frozen=True)
class FixedPoint:
    """The mapping of the positions of some splats to 24-bit numbers."""

    fraction: int
    """Bits behind the point."""
    clamped: int
    """Splats that lie beyond the largest number, and are moved to it."""
    size: float = np.inf
    """Size of a typical Gaussian; a step is at most `FINE` of it."""

    @property
    def step(self) -> float:
        """Step between positions, world units; places are off by half of it at most."""
        return 2.0**-self.fraction

    @property
    def reach(self) -> float:
        """Largest coordinate."""
        return FIXED * self.step

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for a person; none where every splat is where it was."""
        sentences = []
        if self.clamped:
            outliers = plural("outlier", self.clamped)
            sentences.append(
                f"{self.clamped:,} far {outliers} moved to {self.reach:,.0f} units, so that the others keep their places"
            )
        if self.fraction < min(MAX_FRACTION, -np.log2(FINE * self.size)):
            sentences.append(
                f"the splats lie so far apart that places have steps of {self.step:.2g} units, {self.step / self.size:.2g} of a"
                " typical Gaussian's size; PLY keeps them"
            )
        return tuple(sentences)

    @classmethod
    def of(cls, means: np.ndarray, scales: np.ndarray) -> FixedPoint:
        """Return the steps for splats at `means (N,3)` of sizes `scales (N,3)`: all in reach, unless outliers make steps coarse."""
        distance = np.abs(means).max(axis=1, initial=0).astype(np.float64)
        widest, size = _fraction(distance.max(initial=0)), np.inf
        if len(distance):
            size = max(float(np.median(scales.max(axis=1))), 2.0**-MAX_FRACTION)
            wanted = int(np.clip(np.ceil(-np.log2(FINE * size)), 0, MAX_FRACTION))
            bulk = _fraction(float(np.quantile(distance, BULK, method="higher")))
            widest = max(widest, min(wanted, bulk))
        return cls(widest, int(np.count_nonzero(distance > FIXED * 2.0**-widest)), size)


def write_spz(scene: Posable, time: float, path: Path | str, transform: np.ndarray | None = None) -> tuple[str, ...]:
    """Write the scene at clip time `time`, moved by the 4x4 similarity `transform`; returns what a person must know of the file.

    Raises F4xError.
    """
    posed = moment(scene, time, Y_UP if transform is None else Y_UP @ np.asarray(transform, np.float64))
    fixed = FixedPoint.of(posed.means, posed.scales)
    data = pack_spz(Splats(posed.means, posed.quats, posed.scales, posed.opacities, world_harmonics(posed)), fixed)
    with replace_file(path) as file:
        file.write(data)
    return fixed.notes


def pack_spz(splats: Splats, positions: FixedPoint | None = None) -> bytes:
    """Return the file of `splats` in its axes, the harmonics' directions too; `positions` as `FixedPoint.of` tells by default.

    Raises F4xError for too many.
    """
    count = len(splats)
    if count > MAX_POINTS:
        raise F4xError(f"SPZ holds at most {MAX_POINTS} Gaussians, here are {count}; write PLY")
    fraction = (positions or FixedPoint.of(splats.means, splats.scales)).fraction
    fixed = np.clip(np.rint(splats.means.astype(np.float64) * 2**fraction), -FIXED, FIXED).astype("<i4")
    with np.errstate(divide="ignore"):
        scale = SCALE_STEPS * (np.log(splats.scales) + SCALE_ORIGIN)
    header = np.array(
        [(MAGIC, VERSION, count, (spherical_harmonics.degree_of(splats.sh.shape[1]), fraction, 0, 0))], HEADER
    )
    step = np.where(np.arange(1, splats.sh.shape[1]) < 4, *HARMONICS_STEP)[:, None]
    parts = (
        np.ascontiguousarray(fixed).view(np.uint8).reshape(count, 3, 4)[..., :3],
        _bytes(255 * splats.opacities),
        _bytes(255 * (COLOUR_SCALE * splats.sh[:, 0] + 0.5)),
        _bytes(scale),
        _smallest_three(splats.quats),
        _bytes(np.rint((128 * splats.sh[:, 1:] + 128) / step) * step),
    )
    return gzip.compress(header.tobytes() + b"".join(part.tobytes() for part in parts), mtime=0)


def read_spz(path: Path | str) -> Splats:
    """Read versions 2 and 3 into the axes of PLY files (x right, y down, z forward). Raises F4xError that names the damage."""
    path = Path(path)
    try:
        with gzip.open(path) as file:
            start = file.read(HEADER.itemsize)
            if len(start) < HEADER.itemsize or int.from_bytes(start[:4], "little") != MAGIC:
                raise F4xError(f"{path}: a gzip file that holds no SPZ splats; choose another one")
            header = np.frombuffer(start, HEADER)[0]
            version, count, (degree, fraction) = int(header["version"]), int(header["count"]), header["numbers"][:2]
            _require_readable(version, count, int(degree), int(fraction), path)
            sizes = (9, 1, 3, 3, 4 if version == VERSION else 3, 3 * ((int(degree) + 1) ** 2 - 1))
            require_inflation(count * sum(sizes), path.stat().st_size)
            body = file.read(count * sum(sizes))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise F4xError(f"{path}: cannot be read ({error}); copy or export it again") from error
    if len(body) < count * sum(sizes):
        raise F4xError(f"{path}: truncated, it promises {count} splats; copy or export it again")
    ends = count * np.cumsum(sizes)
    parts = np.split(np.frombuffer(body, np.uint8), ends[:-1])
    rows = [part.reshape(count, size) for part, size in zip(parts, sizes, strict=True)]
    splats = Splats(
        *(np.empty((count, *shape), np.float32) for shape in ((3,), (4,), (3,), (), ((degree + 1) ** 2, 3)))
    )
    for first in range(0, count, ROW_BLOCK):
        block = slice(first, first + ROW_BLOCK)
        part = _in_ply_axes(_unpacked([column[block] for column in rows], 2.0 ** -int(fraction)))
        for name, value in part.arrays().items():
            getattr(splats, name)[block] = value
    return splats


def _require_readable(version: int, count: int, degree: int, fraction: int, path: Path) -> None:
    """Raise F4xError for a header that is not read here."""
    if version not in VERSIONS:
        raise F4xError(
            f"{path}: SPZ of version {version}, of which 2 and 3 can be read; convert it to a 3DGS PLY first"
        )
    if count > MAX_POINTS:
        raise F4xError(f"{path}: SPZ of {count:,} splats; more than {MAX_POINTS:,} is {OWN_LIMIT}; thin them out first")
    for name, value, most in (
        ("harmonics of degree", degree, spherical_harmonics.MAX_DEGREE),
        ("bits behind the point:", fraction, POSITION_BITS),
    ):
        if value > most:
            raise F4xError(
                f"{path}: SPZ with a damaged header ({name} {value}, at most {most}); copy or export it again"
            )


def _in_ply_axes(splats: Splats) -> Splats:
    """Return the splats of the file's axes in those of PLY files, with harmonics in each Gaussian's own frame."""
    turn = similarity_of(Y_UP).rotation
    turned = quaternion.multiply(turn, splats.quats.astype(np.float64)).astype(np.float32)
    own = spherical_harmonics.rotate(splats.sh, quaternion.conjugate(splats.quats))
    return Splats(splats.means * np.array([1, -1, -1], np.float32), turned, splats.scales, splats.opacities, own)


def _unpacked(rows: list[np.ndarray], unit: float) -> Splats:
    """Return the splats of the six attributes' bytes (N,k), in the file's axes; `unit` is one step of a position."""
    position, opacity, colour, scale, rotation, harmonics = rows
    count = len(position)
    fixed = np.zeros((count, 3, 4), np.uint8)
    fixed[..., 1:] = position.reshape(count, 3, 3)  # the upper three bytes carry the sign
    sh = np.concatenate(
        [
            ((colour.astype(np.float32) / 255 - 0.5) / COLOUR_SCALE)[:, None],
            (harmonics.reshape(count, harmonics.shape[1] // 3, 3).astype(np.float32) - 128) / 128,
        ],
        axis=1,
    )
    return Splats(
        means=((fixed.view("<i4")[..., 0] >> 8) * unit).astype(np.float32),
        quats=_rotations(rotation),
        scales=np.exp(scale.astype(np.float32) / SCALE_STEPS - SCALE_ORIGIN),
        opacities=opacity[:, 0].astype(np.float32) / 255,
        sh=sh.astype(np.float32),
    )


def _fraction(reach: float) -> int:
    """Return the most fractional bits with which a coordinate of `reach` units is a 24-bit number."""
    return int(np.clip(np.floor(np.log2(FIXED / max(reach, 1e-6))), 0, MAX_FRACTION))


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _smallest_three(quats: np.ndarray) -> np.ndarray:
    """Return (N,) uint32 of wxyz rotations: which of x, y, z, w is largest, then sign and 9 bits of each of the others."""
    xyzw = np.roll(quaternion.normalize(quats.astype(np.float64)), -1, axis=1)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(np.take_along_axis(xyzw, largest[:, None], 1) < 0, -1, 1)
    magnitude = np.minimum(np.abs(xyzw) * np.sqrt(2) * COMPONENT + 0.5, COMPONENT).astype(np.uint32)
    packed = largest.astype(np.uint32)
    for axis in range(4):
        field = (np.uint32(512) * (xyzw[:, axis] < 0)).astype(np.uint32) | magnitude[:, axis]
        packed = np.where(largest == axis, packed, (packed << np.uint32(10)) | field)
    return packed.astype("<u4")


def _rotations(rows: np.ndarray) -> np.ndarray:
    """Return (N,4) unit wxyz float32 of the bytes of rotations, (N,3) in version 2 or (N,4)."""
    xyzw = np.zeros((len(rows), 4))
    if rows.shape[1] == 3:
        xyzw[:, :3] = rows / 127.5 - 1
        largest = np.full(len(rows), 3)
    else:
        packed = np.ascontiguousarray(rows).view("<u4")[:, 0].astype(np.int64)
        largest = packed >> 30
        for axis in (3, 2, 1, 0):
            stored = largest != axis
            value = (packed & COMPONENT) / COMPONENT * np.sqrt(0.5) * np.where(packed & 512, -1, 1)
            xyzw[stored, axis] = value[stored]
            packed = np.where(stored, packed >> 10, packed)
    rest = np.sqrt(np.maximum(1 - (xyzw**2).sum(axis=1), 0))
    np.put_along_axis(xyzw, largest[:, None], rest[:, None], 1)
    return quaternion.normalize(np.roll(xyzw, 1, axis=1)).astype(np.float32)
