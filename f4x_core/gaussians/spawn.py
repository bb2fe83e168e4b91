"""Where Gaussians start: back-projected pixels that nothing covers yet.

Frames are visited coarse to fine in time. In each, the Gaussians that exist already are projected into a grid of cells;
every valid cell without one at about its own depth gets a new Gaussian. The union over frames covers everything seen with
few duplicates, which matters on a CPU (the reference spawns random pixels of all frames and lets optimisation choose).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import uniform_filter
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.spherical_harmonics import dc_from_rgb
from ..scaffold.graph import attach_nodes
from .parameters import DynamicGaussians, StaticGaussians, localise, opacity_logit

# An empty cell with this many Gaussians in the 3 x 3 cells around it is covered by their extent.
COVERING_NEIGHBOURS = 3.5


@dataclass(frozen=True)
class SpawnConfig:
    """How densely Gaussians are placed at the start."""

    spacing: float = 2.0
    """Side of a grid cell in pixels of the fitted image: one Gaussian per uncovered cell."""
    depth_tolerance: float = 0.1
    """An existing Gaussian covers a cell when its depth is within this share of the cell's."""
    scale: float = 0.5
    """Initial standard deviation in units of the spacing."""
    opacity: float = 0.6
    """Initial opacity."""
    most: int = 60_000
    """At most this many Gaussians are spawned."""
    frames: int = 24
    """At most this many frames, evenly spread, are visited."""


@dataclass
class Spawned:
    """New Gaussians in the world: `xyz` (N,3), `rgb` (N,3) in [0,1], `radius` (N,) world units; float32."""

    xyz: np.ndarray
    rgb: np.ndarray
    radius: np.ndarray


def coarse_to_fine(count: int) -> Iterator[int]:
    """0 .. count-1, ends and middle first, each level halving the gaps."""
    seen: set[int] = set()
    step = max(count - 1, 1)
    while len(seen) < count:
        for index in [*range(0, count, step), count - 1]:
            if index not in seen:
                seen.add(index)
                yield index
        step = max(step // 2, 1)


def cover(
    image: np.ndarray,
    depth: np.ndarray,
    valid: np.ndarray,
    camera: Camera,
    existing: np.ndarray,
    config: SpawnConfig,
    rng: np.random.Generator,
) -> Spawned:
    """Spawn one Gaussian in every valid cell of a frame that `existing` does not cover.

    Args:
        image: (H,W,3) uint8. depth: (H,W) z depth, world units. valid: (H,W) bool. camera: of this frame.
        existing: (N,3) world positions at this frame's time.
    """
    height, width = depth.shape
    cells_x = max(int(width / config.spacing), 1)
    cells_y = max(int(height / config.spacing), 1)
    rows, cols = np.nonzero(valid)
    if len(rows) == 0:
        return Spawned(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    order = rng.permutation(len(rows))  # a random pixel of each cell, so that no grid shows
    rows, cols = rows[order], cols[order]
    cell = (rows * cells_y // height) * cells_x + cols * cells_x // width
    _, first = np.unique(cell, return_index=True)
    rows, cols, cell = rows[first], cols[first], cell[first]
    z = depth[rows, cols]
    if len(existing):
        pixels, depths = camera.project(existing)
        with np.errstate(invalid="ignore"):
            column = np.floor(pixels[:, 0] * cells_x / width)
            row = np.floor(pixels[:, 1] * cells_y / height)
        inside = (depths > 0) & (column >= 0) & (column < cells_x) & (row >= 0) & (row < cells_y)
        target = np.full(cells_x * cells_y, np.nan)
        target[cell] = z
        index = (row[inside] * cells_x + column[inside]).astype(np.int64)
        near = np.abs(depths[inside] - target[index]) <= config.depth_tolerance * target[index]
        hits = np.bincount(index[near], minlength=len(target)).reshape(cells_y, cells_x)
        # Points that fill one view evenly fall unevenly into the cells of another: their neighbours count too.
        around = uniform_filter(hits.astype(np.float32), 3, mode="nearest") * 9
        covered = ((hits > 0) | (around >= COVERING_NEIGHBOURS)).ravel()
        keep = ~covered[cell]
        rows, cols, z = rows[keep], cols[keep], z[keep]
    pixels = np.stack([cols + 0.5, rows + 0.5], -1)
    focal = 0.5 * (camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    return Spawned(
        camera.unproject(pixels, z).astype(np.float32),
        (image[rows, cols] / 255.0).astype(np.float32),
        (z / focal * config.spacing * config.scale).astype(np.float32),
    )


def _parameters(spawned: Spawned, degree: int, opacity: float) -> dict[str, Tensor]:
    count, coefficients = len(spawned.xyz), (degree + 1) ** 2
    dc = torch.from_numpy(dc_from_rgb(spawned.rgb).astype(np.float32))
    return {
        "log_scale": torch.from_numpy(spawned.radius).log()[:, None].repeat(1, 3),
        "opacity_logit": opacity_logit(torch.full((count,), opacity)),
        "sh_dc": dc[:, None].clone(),
        "sh_rest": torch.zeros(count, coefficients - 1, 3),
    }


def _identity_quaternions(count: int) -> Tensor:
    return torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)


def _trainable(parameters: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.contiguous().requires_grad_(True) for name, tensor in parameters.items()}


def spawn_static(spawned: Spawned, degree: int, config: SpawnConfig, first_id: int = 0) -> StaticGaussians:
    """Static Gaussians of SH degree `degree` at back-projected pixels, ids from `first_id` on."""
    count = len(spawned.xyz)
    parameters = {"xyz": torch.from_numpy(spawned.xyz), "quat": _identity_quaternions(count)}
    parameters |= _parameters(spawned, degree, config.opacity)
    return StaticGaussians(_trainable(parameters), {"ids": torch.arange(first_id, first_id + count)})


def spawn_dynamic(
    spawned: Spawned,
    reference: np.ndarray,
    node_xyz: Tensor,
    node_quat: Tensor,
    neighbours: int,
    degree: int,
    config: SpawnConfig,
    first_id: int = 0,
) -> DynamicGaussians:
    """Dynamic Gaussians, each attached to the node nearest at its reference frame.

    Args:
        reference: (N,) frame index of each Gaussian. node_xyz: (F,M,3). node_quat: (F,M,4). neighbours: K.
    """
    count = len(spawned.xyz)
    frame, x = torch.from_numpy(reference).long(), torch.from_numpy(spawned.xyz)
    attach = torch.from_numpy(attach_nodes(spawned.xyz, reference, node_xyz.numpy()))
    local_x, local_q = localise(x, _identity_quaternions(count), attach, frame, node_xyz, node_quat)
    parameters = {"local_xyz": local_x, "local_quat": local_q}
    parameters |= _parameters(spawned, degree, config.opacity)
    parameters["dw"] = torch.zeros(count, neighbours)
    labels = {"ids": torch.arange(first_id, first_id + count), "attach": attach, "reference": frame}
    return DynamicGaussians(_trainable(parameters), labels)
