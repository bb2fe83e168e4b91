"""Places the first Gaussians: back-projected pixels that nothing covers yet.

Frames are visited coarse to fine in time. In each, the Gaussians that exist already are projected into a grid of cells;
every valid cell without one at about its own depth gets a new Gaussian, blocks of cells that show nothing (a wall, the sky)
a single larger one. The union over frames covers everything seen with few duplicates, which matters on a CPU (the reference
spawns random pixels of all frames and lets optimisation choose). How many that are follows from the clip; where there is no
room for them, all cells grow alike (`spawn_that_fits`), so that no part of the clip is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Sized
from dataclasses import dataclass, fields, replace
from typing import Generic, TypeVar

import numpy as np
import torch
from scipy.ndimage import correlate
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.spherical_harmonics import dc_from_rgb
from ..geometry.splats import Splats
from ..scaffold.graph import attach_nodes
from ..scaffold.structure import Scaffold
from .parameters import DynamicGaussians, StaticGaussians, localise, opacity_logit

# An empty cell with this many Gaussians in the 3 x 3 cells around it is covered by their extent.
COVERING_NEIGHBOURS = 4
# Blocks of 2 x 2 and of 4 x 4 cells get one Gaussian where their grey levels (of 255) and their depths (relative) deviate less.
MAX_LEVEL, FLAT_GREY, FLAT_DEPTH = 2, 3.0, 0.02
# Spacings that are tried until all Gaussians fit, and how much larger than needed the next one is: counts jump a little.
FITTING_ROUNDS, FITTING_MARGIN = 6, 1.03
# The lifetime, in clip frames, of a Gaussian that is always there.
ALWAYS = 1e6
# Scales of an earlier fit are at least so many world units before their logarithm is taken.
MIN_SCALE = 1e-9

Made = TypeVar("Made", bound=Sized)


@dataclass(frozen=True)
class SpawnConfig:
    """Settings of the density of Gaussians at the start."""

    spacing: float = 2.0
    """Side of a grid cell in pixels of the fitted image: one Gaussian per uncovered cell."""
    depth_tolerance: float = 0.1
    """An existing Gaussian covers a cell when its depth is within this fraction of the cell's."""
    scale: float = 0.5
    """Initial standard deviation in units of the spacing."""
    opacity: float = 0.6
    """Initial opacity."""
    max_count: int = 120_000
    """Room in memory and time: where a clip asks for more Gaussians than this, all of it is covered more thinly."""
    frames: int = 24
    """At most this many frames, evenly spread, are visited; of moving objects also those that these leave open."""


@dataclass
class Spawned:
    """New Gaussians in the world: `means` (N,3), `rgb` (N,3) in [0,1], `radius` (N,) and `depth` (N,) world units; float32."""

    means: np.ndarray
    rgb: np.ndarray
    radius: np.ndarray
    depth: np.ndarray
    """Distance along the camera's axis, which tells the size of a pixel there."""

    def __len__(self) -> int:
        return len(self.means)

    @classmethod
    def joined(cls, parts: Sequence[Spawned]) -> Spawned:
        """Return all of `parts`, in order."""
        if not parts:
            return cls(*(np.zeros(shape, np.float32) for shape in ((0, 3), (0, 3), (0,), (0,))))
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


@dataclass(frozen=True)
class Room:
    """Number of Gaussians that a clip asks for at the start of a set, and number allowed there."""

    asked: int
    """Gaussians with the spacing that the settings name."""
    allowed: int
    """`SpawnConfig.max_count`."""

    @property
    def short(self) -> bool:
        """Return True if less is allowed than is asked for, so that the whole clip is covered more thinly."""
        return self.asked > self.allowed


@dataclass(frozen=True)
class FittingStart(Generic[Made]):
    """The first Gaussians of a set, as dense as there is room for."""

    made: Made
    config: SpawnConfig
    """The settings that made them: those asked for, or with a larger spacing."""
    room: Room


def spawn_that_fits(spawn: Callable[[SpawnConfig], Made], config: SpawnConfig) -> FittingStart[Made]:
    """Run `spawn` with `config`, or with a larger spacing where it would exceed `config.max_count`.

    `spawn(config)` makes something whose length is its number of Gaussians.
    """
    made = spawn(config)
    room = Room(len(made), config.max_count)
    for _ in range(FITTING_ROUNDS):
        if len(made) <= config.max_count:
            break
        config = replace(config, spacing=config.spacing * FITTING_MARGIN * float(np.sqrt(len(made) / config.max_count)))
        made = spawn(config)
    return FittingStart(made, config, room)


def coarse_to_fine(count: int) -> Iterator[int]:
    """Yield 0 .. count-1, ends and middle first, each level halving the gaps."""
    seen: set[int] = set()
    step = count - 1
    while len(seen) < count:
        for index in [*range(0, count, max(step, 1)), count - 1]:
            if index not in seen:
                seen.add(index)
                yield index
        step //= 2


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A frame, the depth of its pixels and its camera."""

    image: np.ndarray
    """(H,W,3) uint8."""
    depth: np.ndarray
    """(H,W) z depth, world units."""
    valid: np.ndarray
    """(H,W) bool: pixels that may get a Gaussian."""
    camera: Camera
    tolerance: np.ndarray | None = None
    """(H,W) relative difference of depth within which an existing Gaussian covers a cell; None: that of `SpawnConfig`. Where
    depth is unsure, two frames put the same surface at different depths."""


def cover(view: DepthImage, existing: np.ndarray, config: SpawnConfig, rng: np.random.Generator) -> Spawned:
    """Spawn one Gaussian in every valid cell, or block of plain cells, of a frame that `existing` does not cover.

    `existing`: (N,3) world positions at the frame's time.
    """
    depth, camera = view.depth, view.camera
    rows, cols = np.nonzero(view.valid)
    grid = _Grid.over(view.image, depth, view.valid, config.spacing)
    order = rng.permutation(len(rows))  # a random pixel of each cell, so that no grid shows
    rows, cols = rows[order], cols[order]
    _, first = np.unique(grid.cell(rows, cols), return_index=True)
    first.sort()  # in random order still, so that blocks do not all take the same corner
    rows, cols = rows[first], cols[first]
    allowed = np.full(len(rows), config.depth_tolerance) if view.tolerance is None else view.tolerance[rows, cols]
    covered = grid.covered(rows, cols, depth[rows, cols], allowed, camera, existing)
    _, first = np.unique(grid.block(rows, cols), return_index=True)
    first = first[~covered[first]]
    rows, cols = rows[first], cols[first]
    z, size = depth[rows, cols], config.spacing * 2.0 ** grid.level_at(rows, cols)
    pixels = np.stack([cols + 0.5, rows + 0.5], 1)
    focal = 0.5 * (camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    return Spawned(
        camera.unproject(pixels, z).astype(np.float32),
        (view.image[rows, cols] / 255.0).astype(np.float32),
        (z / focal * size * config.scale).astype(np.float32),
        z.astype(np.float32),
    )


@dataclass(frozen=True)
class _Grid:
    """Cells of a picture, and how many of them one Gaussian covers."""

    height: int
    width: int
    level: np.ndarray
    """(cells_y, cells_x) int: 0 a cell of its own, 1 and 2 part of a plain block of 2 x 2 or 4 x 4."""

    @classmethod
    def over(cls, image: np.ndarray, depth: np.ndarray, valid: np.ndarray, spacing: float) -> _Grid:
        height, width = depth.shape
        shape = max(int(height / spacing), 1), max(int(width / spacing), 1)
        grid = cls(height, width, np.zeros(shape, np.int64))
        rows, cols = np.ogrid[:height, :width]
        cell, known = grid.cell(rows, cols).ravel(), valid.ravel()
        values = [image.mean(-1).ravel(), np.log(np.where(known, depth.ravel(), 1.0))]
        sums = [np.bincount(cell, v, shape[0] * shape[1]).reshape(shape) for v in values]
        squares = [np.bincount(cell, v * v, shape[0] * shape[1]).reshape(shape) for v in values]
        inside = np.bincount(cell, known, shape[0] * shape[1]).reshape(shape)
        whole = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
        for level in range(1, MAX_LEVEL + 1):
            count, pixels = _blocks(inside, level), _blocks(whole, level)
            plain = count == pixels  # so that it does not matter what stands for unknown depth
            for total, square, limit in zip(sums, squares, (FLAT_GREY, FLAT_DEPTH), strict=True):
                mean = _blocks(total, level) / np.maximum(count, 1)
                plain &= _blocks(square, level) / np.maximum(count, 1) - mean**2 < limit**2
            grid.level[_cells(plain, level, shape) & (grid.level == level - 1)] = level
        return grid

    def cell(self, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        """Return the number of the cell of each pixel."""
        down, across = self.level.shape
        return (rows * down // self.height) * across + cols * across // self.width

    def level_at(self, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        """Return the level of the cell of each pixel."""
        return self.level.ravel()[self.cell(rows, cols)]

    def block(self, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        """Return the number of the block of each pixel, unique over all levels."""
        down, across = self.level.shape
        cell = self.cell(rows, cols)
        level = self.level.ravel()[cell]
        return (level * down + ((cell // across) >> level)) * across + ((cell % across) >> level)

    def covered(
        self,
        rows: np.ndarray,
        cols: np.ndarray,
        z: np.ndarray,
        tolerance: np.ndarray,
        camera: Camera,
        existing: np.ndarray,
    ) -> np.ndarray:
        """Return (n,) bool: pixels, one a cell, in whose block an existing Gaussian lies at their depth `z`, or many beside it."""
        down, across = self.level.shape
        if not len(existing):
            return np.zeros(len(rows), bool)
        pixels, depths = camera.project(existing)
        with np.errstate(invalid="ignore"):
            column, row = np.floor(pixels[:, 0] * across / self.width), np.floor(pixels[:, 1] * down / self.height)
        inside = (depths > 0) & (column >= 0) & (column < across) & (row >= 0) & (row < down)
        target, allowed = np.full((2, down * across), np.nan)
        cell = self.cell(rows, cols)
        target[cell], allowed[cell] = z, tolerance * z
        index = (row[inside] * across + column[inside]).astype(np.int64)
        near = np.abs(depths[inside] - target[index]) <= allowed[index]
        hits = np.bincount(index[near], minlength=len(target)).reshape(down, across)
        result = np.zeros((down, across), bool)
        for level in range(MAX_LEVEL + 1):
            own = _blocks(hits, level)
            # Points that fill one view evenly fall unevenly into the cells of another: their neighbours count too.
            around = correlate(own, np.ones((3, 3), int), mode="nearest")
            block = (own > 0) | (around >= COVERING_NEIGHBOURS)
            result = np.where(self.level == level, _cells(block, level, result.shape), result)
        return result.ravel()[cell]


def _blocks(cells: np.ndarray, level: int) -> np.ndarray:
    """Return the sums over blocks of `2**level` x `2**level` cells; those at the rim are padded with nothing."""
    side = 2**level
    padded = np.pad(cells, [(0, -size % side) for size in cells.shape])
    return padded.reshape(padded.shape[0] // side, side, -1, side).sum((1, 3))


def _cells(blocks: np.ndarray, level: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return for each of `shape` cells the value of its block of `2**level` x `2**level`."""
    row, column = np.ogrid[: shape[0], : shape[1]]
    return blocks[row >> level, column >> level]


def _parameters(spawned: Spawned, degree: int, opacity: float) -> dict[str, Tensor]:
    count, coefficients = len(spawned.means), (degree + 1) ** 2
    dc = torch.from_numpy(dc_from_rgb(spawned.rgb).astype(np.float32))
    return {
        "log_scales": torch.from_numpy(spawned.radius).log()[:, None].repeat(1, 3),
        "opacity_logits": opacity_logit(torch.full((count,), opacity)),
        "sh0": dc[:, None].clone(),
        "shN": torch.zeros(count, coefficients - 1, 3),
    }


def _identity_quaternions(count: int) -> Tensor:
    return torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)


def _trainable(parameters: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.contiguous().requires_grad_(True) for name, tensor in parameters.items()}


def spawn_static(spawned: Spawned, degree: int, config: SpawnConfig, first_id: int = 0) -> StaticGaussians:
    """Return the static Gaussians of SH degree `degree` at back-projected pixels, ids from `first_id` on."""
    count = len(spawned.means)
    parameters = {"means": torch.from_numpy(spawned.means), "quats": _identity_quaternions(count)}
    parameters |= _parameters(spawned, degree, config.opacity)
    labels = {"ids": torch.arange(first_id, first_id + count), "reach": torch.from_numpy(spawned.depth)}
    labels["earlier"] = torch.zeros(count, dtype=torch.bool)
    return StaticGaussians(_trainable(parameters), labels)


def learnt_before(splats: Splats, reach: Tensor, first_id: int) -> StaticGaussians:
    """Return static Gaussians that go on from an earlier fit: `splats` of tensors, `reach` (N,), ids from `first_id` on."""
    splats = splats.map(torch.clone)  # what is optimised shares no memory with what it comes from
    parameters = {
        "means": splats.means,
        "quats": splats.quats,
        "log_scales": splats.scales.clamp_min(MIN_SCALE).log(),
        "opacity_logits": opacity_logit(splats.opacities),
        "sh0": splats.sh[:, :1],
        "shN": splats.sh[:, 1:],
    }
    labels = {"ids": torch.arange(first_id, first_id + len(reach)), "reach": reach}
    labels["earlier"] = torch.ones(len(reach), dtype=torch.bool)
    return StaticGaussians(_trainable(parameters), labels)


def spawn_dynamic(
    spawned: Spawned, reference: np.ndarray, scaffold: Scaffold, degree: int, config: SpawnConfig, first_id: int = 0
) -> DynamicGaussians:
    """Return dynamic Gaussians, each attached to the node nearest at its reference frame.

    `reference (N,)` are indices into the F of `scaffold`, whose quaternions have length 1.
    """
    count = len(spawned.means)
    frame, x = torch.from_numpy(reference).long(), torch.from_numpy(spawned.means)
    attach = torch.from_numpy(attach_nodes(spawned.means, reference, scaffold.xyz))
    nodes = torch.from_numpy(scaffold.xyz), torch.from_numpy(scaffold.quat)
    local_x, local_q = localise(x, _identity_quaternions(count), attach, frame, *nodes)
    parameters = {"local_means": local_x, "local_quats": local_q}
    parameters |= _parameters(spawned, degree, config.opacity)
    parameters["dw"] = torch.zeros(count, scaffold.neighbours.shape[1])
    parameters["log_lifetimes"] = torch.full((count, 2), ALWAYS).log()
    labels = {"ids": torch.arange(first_id, first_id + count), "attach": attach, "reference": frame}
    labels["reach"] = torch.from_numpy(spawned.depth)
    return DynamicGaussians(_trainable(parameters), labels)
