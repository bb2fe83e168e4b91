"""The `torch` backend: tile-wise alpha compositing as batched GEMMs with a hand-written backward; any device and dtype.

A tile's front-to-back list is cut into slabs of `SLAB` splats. For a batch of tiles, one slab is a dense block
(tiles, pixels, splats): log2 alpha is a 6-term polynomial of the pixel's place in the tile (one bmm), one cumprod gives
transmittance, blending weights and stop rule at once, and channels are contracted by a second bmm.
Batches are independent and each writes rows of its own, so the number of threads never changes a bit of the result.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import embedding_bag, pad

from ..native.kernels import torch_threads
from .binning import TileLists, bands_of, build_tile_lists
from .contract import RasterConfig, RasterInput, RasterOutput
from .projection import project

# Splats blended at once; a tile can stop between slabs. Shorter slabs starve the GEMMs, longer ones overshoot the stop.
SLAB = 32
# Pixels x splats worked on at once: enough to hide the cost of a call, few enough to stay in a core's cache.
ELEMENTS_CPU, ELEMENTS_ACCELERATOR = 2**18, 2**23
# A batch drops its finished tiles as soon as fewer than this fraction of it is still at work.
COMPACT_BELOW = 0.85
# Work memory up to this size is kept for the next call: fresh pages cost more than the arithmetic done in them.
KEPT_BYTES = 2**28
# Pairs of splat and tile of a picture without gradients that are in memory at once, about 150 bytes each: a picture of 3840x2160
# with a million large splats has a hundred million.
PAIRS = 2**22
# log2 alpha of a padding slot: 2^-1000 is 0 in every float type that gets here.
PADDING = -1000.0
# alpha = 2^(log2 opacity + HALF q).
HALF = -0.5 / math.log(2)

Item = TypeVar("Item")
Result = TypeVar("Result")


def rasterize_torch(inputs: RasterInput) -> RasterOutput:
    """Composite Gaussians, tensors only; see `rasterize`. Without gradients band by band, so that memory has a bound."""
    config, colors, width, height = inputs.config, inputs.colors, inputs.camera.width, inputs.camera.height
    ellipses = project(inputs.splats, inputs.camera, config, inputs.mean2d_offset)
    features = torch.cat((torch.ones_like(ellipses.depth)[:, None], ellipses.depth[:, None], colors), 1)
    attached = 2 + inputs.attached_channels
    recording = torch.is_grad_enabled() and (ellipses.table.requires_grad or features.requires_grad)
    bands = [range(-(-height // config.tile))] if recording else bands_of(ellipses, width, height, config, PAIRS)
    parts = []
    for band in bands:
        lists = build_tile_lists(ellipses, width, height, SLAB, config, band)
        grid = _Grid(width, height, config.tile, band)
        parts.append(_Composite.apply(ellipses.table, features, _Layout(lists, grid, config, attached)))
    channels, depth, alpha = (rows[0] if len(rows) == 1 else torch.cat(rows) for rows in zip(*parts, strict=True))
    return RasterOutput(add_background(inputs, channels, alpha), depth, alpha, ellipses.visible)


def add_background(inputs: RasterInput, channels: Tensor, alpha: Tensor) -> Tensor:
    """Return the channels (H, W, C) plus the background times the light left, 1 - alpha (H, W); detached channels detach it."""
    if inputs.background is None:
        return channels
    light, attached = (1 - alpha)[..., None], inputs.attached_channels
    kept = channels[..., :attached] + light * inputs.background[:attached]
    if attached == channels.shape[-1]:
        return kept
    return torch.cat((kept, channels[..., attached:] + light.detach() * inputs.background[attached:]), -1)


class _Grid:
    """A band of the image, some rows of square tiles; the last column and row of tiles may hang over the image's edge."""

    def __init__(self, width: int, height: int, side: int, band: range):
        self.width, self.side, self.pixels = width, side, side * side
        self.height = min(band.stop * side, height) - band.start * side
        self.columns, self.rows, self.first_row = -(-width // side), len(band), band.start

    def basis(self, like: Tensor) -> Tensor:
        """Return (6, pixels) monomials 1, u, v, u^2, uv, v^2 of a pixel centre relative to the tile centre."""
        axis = torch.arange(self.side, dtype=like.dtype, device=like.device) + 0.5 - self.side / 2
        v, u = (c.reshape(-1) for c in torch.meshgrid(axis, axis, indexing="ij"))
        return torch.stack((torch.ones_like(u), u, v, u * u, u * v, v * v))

    def centres(self, tile: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
        """Return x and y of the centres of tiles, pixels."""
        y = torch.div(tile, self.columns, rounding_mode="floor")
        x = tile - y * self.columns
        return (x.to(like) + 0.5) * self.side, ((y + self.first_row).to(like) + 0.5) * self.side

    def to_image(self, tiles: Tensor) -> Tensor:
        """Return (tiles, C, pixels) -> (C, H, W)."""
        cut = tiles.view(self.rows, self.columns, -1, self.side, self.side).permute(2, 0, 3, 1, 4)
        image = cut.clone(memory_format=torch.contiguous_format)  # `tiles` is work memory, never to be given away
        image = image.view(-1, self.rows * self.side, self.columns * self.side)
        return image[:, : self.height, : self.width]

    def to_tiles(self, image: Tensor, out: Tensor) -> None:
        """Write an image (C, H, W) into `out` (tiles, C, pixels), with 0 outside it."""
        image = pad(image, (0, self.columns * self.side - self.width, 0, self.rows * self.side - self.height))
        cut = image.view(-1, self.rows, self.side, self.columns, self.side).permute(1, 3, 0, 2, 4)
        out.view(self.rows, self.columns, -1, self.side, self.side).copy_(cut)


class _Scratch(threading.local):
    """Named work memory of one thread, grown on demand and reused by the next slab and the next call."""

    def __init__(self) -> None:
        self._flat: dict[tuple, Tensor] = {}

    def __call__(self, name: str, like: Tensor, *shape: int) -> Tensor:
        """Return an uninitialised tensor of `shape` and of the type of `like`, valid until the name is asked for again."""
        key, size = (name, like.dtype, like.device), math.prod(shape)
        flat = self._flat.get(key)
        if flat is None or len(flat) < size:
            flat = like.new_empty(size)
            if flat.nbytes <= KEPT_BYTES:
                self._flat[key] = flat
        return flat[:size].view(shape)


_scratch = _Scratch()
_pools: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)


def _map(function: Callable[[Item], Result], items: Sequence[Item], threads: int) -> list[Result]:
    """Return `[function(item) for item in items]`, spread over Python threads; torch lets go of the GIL inside its operations."""
    threads = min(threads, len(items))
    if threads <= 1:
        return [function(item) for item in items]
    if threads not in _pools:
        # Each worker keeps to one core: spinning OpenMP teams inside them would fight over the same cores.
        with torch_threads(1):
            _pools[threads] = ThreadPoolExecutor(threads, "raster", torch.set_num_threads, (1,))
            list(_pools[threads].map(lambda _: None, range(threads)))
    return list(_pools[threads].map(torch.no_grad()(function), items))


class _Slab(NamedTuple):
    """Slab of a batch of tiles, kept for the backward pass."""

    tiles: Tensor
    """(t,)"""
    ancestors: tuple[Tensor, Tensor] | None
    """The tiles (s,) of the slab before and the places (t,) of this slab's tiles among them; none = the same tiles."""
    blocks: Tensor
    """(t,) block of `TileLists` that every tile blends."""
    light: Tensor
    """(t, pixels) transmittance in front of the slab, 0 where the pixel has stopped."""


class _Scene(NamedTuple):
    """Arrays that the compositing loops read."""

    theta: Tensor
    """(B, 6, SLAB) coefficients of log2 alpha over `basis` for every slot."""
    features: Tensor
    """(N, 2 + C) columns 1, z, colors."""
    lists: TileLists
    basis: Tensor
    """(6, pixels)"""
    config: RasterConfig

    def slab_features(self, blocks: Tensor) -> Tensor:
        """Return (t, SLAB, 2 + C)."""
        ids = self.lists.ids.index_select(0, blocks).view(-1)
        out = _scratch("features", self.features, len(ids), self.features.shape[1])
        return torch.index_select(self.features, 0, ids, out=out).view(len(blocks), SLAB, -1)


class _Layout(NamedTuple):
    """Gaussians that each tile blends, and places of the tiles in the image."""

    lists: TileLists
    grid: _Grid
    config: RasterConfig
    attached: int
    """Columns of the features from here on send no gradient to the table."""


class _Composite(torch.autograd.Function):
    """table (6, N), features (N, 2 + C) -> channels (H, W, C), depth (H, W), alpha (H, W)."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, table: Tensor, features: Tensor, layout: _Layout
    ) -> tuple[Tensor, Tensor, Tensor]:
        lists, grid, config, _ = layout
        scene = _Scene(_polynomials(table, lists, grid), features, lists, grid.basis(table), config)
        recording = any(ctx.needs_input_grad[:2])
        tiles = _scratch("tiles", features, len(lists.length), features.shape[1], grid.pixels).zero_()
        batches = _batches(lists, grid.pixels)
        slabs = _map(lambda batch: _blend(batch, scene, tiles, recording), batches, _threads(config, table))
        if recording:
            ctx.save_for_backward(table, features, scene.theta)
            ctx.layout = layout
            ctx.slabs = slabs
            ctx.set_materialize_grads(False)
        image = grid.to_image(tiles)
        return image[2:].permute(1, 2, 0), image[1], image[0]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        table, features, theta = ctx.saved_tensors
        lists, grid, config, attached = ctx.layout
        scene = _Scene(theta, features, lists, grid.basis(table), config)
        grad_tiles = _scratch("tiles", features, len(lists.length), features.shape[1], grid.pixels)
        for part, grad in zip((slice(2, None), slice(1, 2), slice(0, 1)), grads, strict=True):
            if grad is None:
                grad_tiles[:, part] = 0
            else:
                grid.to_tiles(grad.permute(2, 0, 1) if grad.dim() == 3 else grad[None], grad_tiles[:, part])
        return (*_differentiate(ctx.slabs, grad_tiles, table, scene, grid, attached), None)


def _threads(config: RasterConfig, like: Tensor) -> int:
    return config.threads if like.device.type == "cpu" else 1


def _batches(lists: TileLists, pixels: int) -> list[Tensor]:
    """Return the tiles that have anything to blend, in batches of similar list length."""
    order = torch.argsort(lists.length, descending=True, stable=True)[: int((lists.length > 0).sum())]
    elements = ELEMENTS_CPU if order.device.type == "cpu" else ELEMENTS_ACCELERATOR
    return list(order.split(max(1, elements // (SLAB * pixels)))) if len(order) else []


def _polynomials(table: Tensor, lists: TileLists, grid: _Grid) -> Tensor:
    """Return (B, 6, SLAB) coefficients of log2 alpha over `_Grid.basis` for every slot."""
    if table.shape[1] == 0:
        return table.new_empty(len(lists.ids), 6, SLAB)
    oy, e, A, k, r, log_opacity = _local(table, lists.ids, lists.tile, grid)
    Ae, ro = A * e, r * oy
    theta = table.new_empty(len(lists.ids), 6, SLAB)
    theta[:, 0] = log_opacity + HALF * (Ae * e + ro * oy)
    theta[:, 1] = Ae * (-2 * HALF)
    theta[:, 2] = (k * Ae - ro) * (2 * HALF)
    theta[:, 3] = A * HALF
    theta[:, 4] = A * k * (-2 * HALF)
    theta[:, 5] = (A * k * k + r) * HALF
    theta.masked_fill_(lists.padding[:, None], 0.0)[:, 0].masked_fill_(lists.padding, PADDING)
    return theta


def _local(table: Tensor, ids: Tensor, tile: Tensor, grid: _Grid) -> tuple[Tensor, ...]:
    """Return (B, SLAB) each: y of the mean from the tile centre, e = x - k y from there, then A, k, r, log2 opacity."""
    mx, my, A, k, r, log_opacity = table.index_select(1, ids.view(-1)).view(6, -1, SLAB)
    x, y = grid.centres(tile[:, None], table)
    oy = my - y
    return oy, (mx - x) - k * oy, A, k, r, log_opacity


def _blend(tiles: Tensor, scene: _Scene, out: Tensor, recording: bool) -> list[_Slab]:
    """Composite a batch of tiles, longest list first, front to back into their rows of `out` (tiles, 2 + C, pixels)."""
    first, count = scene.lists.first[tiles], scene.lists.length[tiles]
    light = out.new_ones(len(tiles), out.shape[2])
    total = out.new_zeros(len(tiles), *out.shape[1:])
    padding = len(scene.lists.ids) - 1
    slabs: list[_Slab] = []
    for level in range(int(count[0])):
        alive = (count > level) & (light.amax(1) > 0)
        living, ancestors = int(alive.sum()), None
        if living < COMPACT_BELOW * len(tiles):
            done = (~alive).nonzero()[:, 0]
            out.index_copy_(0, tiles[done], total.index_select(0, done))
            if living == 0:
                return slabs
            survivors = alive.nonzero()[:, 0]
            ancestors = tiles, survivors
            tiles, first, count, light, total, alive = (
                x.index_select(0, survivors) for x in (tiles, first, count, light, total, alive)
            )
        blocks = torch.where(alive, first + level, padding)
        if recording:
            slabs.append(_Slab(tiles, ancestors, blocks, light))
        weights, _, _, light = _weights(blocks, light, scene)
        total.baddbmm_(scene.slab_features(blocks).transpose(1, 2), weights.transpose(1, 2))
    out.index_copy_(0, tiles, total)
    return slabs


def _weights(blocks: Tensor, light: Tensor, scene: _Scene) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the weights alpha T, alpha / (1 - alpha) and 1 - alpha of one slab (t, pixels, SLAB), and the light behind it."""
    theta, basis, config = scene.theta, scene.basis, scene.config
    shape = (len(blocks), basis.shape[1], SLAB)
    alpha, keep, after = (_scratch(name, theta, *shape) for name in ("alpha", "keep", "after"))
    slab_theta = torch.index_select(theta, 0, blocks, out=_scratch("theta", theta, len(blocks), 6, SLAB))
    torch.bmm(basis.t().expand(len(blocks), -1, -1), slab_theta, out=alpha)
    torch.threshold_(alpha.exp2_(), config.alpha_min, 0.0).clamp_max_(config.alpha_max)
    torch.sub(theta.new_ones(()), alpha, out=keep)
    torch.cumprod(keep, -1, out=after)
    # The product never rises, so one threshold drops the stopping splat and everything behind it.
    torch.threshold_(after.mul_(light[..., None]), config.transmittance_min, 0.0)
    light = after[..., -1].clone()
    ratio = alpha.div_(keep)
    return after.mul_(ratio), ratio, keep, light


@dataclass(frozen=True, eq=False)
class _Gradients:
    """Gradients of the tiles, and what the backward pass fills."""

    tiles: Tensor
    """(tiles, 2 + C, pixels), given."""
    theta: Tensor
    """(blocks, 6, SLAB), filled."""
    feature_rows: Tensor
    """(blocks * SLAB + 1, 2 + C), filled."""
    attached: int
    """Number of channels, counted from the first, that send gradients to alpha."""


def _differentiate(
    slabs: list[list[_Slab]], grad_tiles: Tensor, table: Tensor, scene: _Scene, grid: _Grid, attached: int
) -> tuple[Tensor, Tensor]:
    """Return the gradients of table (6, N) and features (N, 2 + C) from those of the tiles (tiles, 2 + C, pixels)."""
    lists, channels = scene.lists, grad_tiles.shape[1]
    ends = torch.tensor([sum(len(slab.tiles) for slab in batch) for batch in slabs]).cumsum(0).tolist()
    blocks = ends[-1] if ends else 0
    # One row per slot that was blended, and a last row of zeros for those behind the stop.
    grad_theta = _scratch("grad_theta", table, blocks, 6, SLAB)
    feature_rows = _scratch("feature_rows", table, blocks * SLAB + 1, channels)
    table_rows = _scratch("table_rows", table, blocks * SLAB + 1, 6)
    feature_rows[-1], table_rows[-1] = 0, 0

    gradients = _Gradients(grad_tiles, grad_theta, feature_rows, attached)

    def task(item: tuple[list[_Slab], int]) -> None:
        _blend_backward(*item, scene, gradients)

    _map(task, list(zip(slabs, ends, strict=True)), _threads(scene.config, table))
    grad_table, grad_features = torch.zeros_like(table), torch.zeros_like(scene.features)
    if blocks:
        done = torch.cat([slab.blocks for batch in slabs for slab in batch])
        grad_local = _pull_back(grad_theta, *_local(table, lists.ids[done], lists.tile[done], grid)[:5])
        torch.stack(grad_local, -1, out=table_rows[:-1].view(blocks, SLAB, 6))
        place = done.new_full((len(lists.ids), SLAB), blocks * SLAB)
        place[done] = torch.arange(blocks * SLAB, device=done.device).view(blocks, SLAB)
        rows = place.view(-1).index_select(0, lists.slots)
        grad_table[:, lists.splats] = embedding_bag(rows, table_rows, lists.offsets, mode="sum").t()
        grad_features[lists.splats] = embedding_bag(rows, feature_rows, lists.offsets, mode="sum")
    return grad_table, grad_features


def _blend_backward(slabs: list[_Slab], end: int, scene: _Scene, gradients: _Gradients) -> None:
    """Go through a batch's slabs back to front and fill its rows, which end before block `end`.

    With w = alpha T and S = features . grad, d out / d log alpha_i = w_i S_i - alpha_i / (1 - alpha_i) sum_{j>i} w_j S_j.
    """
    theta, grad_tiles, attached = scene.theta, gradients.tiles, gradients.attached
    channels = grad_tiles.shape[1]
    moments = scene.basis * math.log(2)  # d log2 alpha = d log alpha / ln 2
    clamped = float(1 - theta.new_tensor(scene.config.alpha_max))
    tiles = slabs[-1].tiles
    grad, behind = grad_tiles.index_select(0, tiles), theta.new_zeros(len(tiles), grad_tiles.shape[2])
    for slab in reversed(slabs):
        begin, t = end - len(slab.tiles), len(slab.tiles)
        weights, ratio, keep, _ = _weights(slab.blocks, slab.light, scene)
        features = scene.slab_features(slab.blocks)
        shaded, suffix = (_scratch(name, theta, *weights.shape) for name in ("shaded", "suffix"))
        torch.bmm(grad[:, :attached].transpose(1, 2), features[..., :attached].transpose(1, 2), out=shaded)
        torch.cumsum(shaded.mul_(weights), -1, out=suffix)
        behind += suffix[..., -1]
        suffix.sub_(behind[..., None]).mul_(ratio).add_(shaded)
        # A clamped alpha sends no gradient.
        torch.ops.aten.threshold_backward.grad_input(suffix, keep, clamped, grad_input=suffix)
        torch.bmm(moments.expand(t, -1, -1), suffix, out=gradients.theta[begin:end])
        rows = torch.bmm(grad, weights, out=_scratch("rows", theta, t, channels, SLAB))
        gradients.feature_rows[begin * SLAB : end * SLAB].view(t, SLAB, channels).copy_(rows.transpose(1, 2))
        end = begin
        if slab.ancestors is not None:
            tiles, survivors = slab.ancestors
            grad = grad_tiles.index_select(0, tiles)
            behind = behind.new_zeros(len(tiles), behind.shape[1]).index_copy_(0, survivors, behind)


def _pull_back(grad_theta: Tensor, oy: Tensor, e: Tensor, A: Tensor, k: Tensor, r: Tensor) -> tuple[Tensor, ...]:
    """Return the gradients (b, SLAB) of the six rows of the table from those of the coefficients of `_polynomials`."""
    g0, g1, g2, g3, g4, g5 = grad_theta.unbind(1)
    p = e * g0 - g1 + k * g2
    d_e = 2 * HALF * A * p
    d_oy = 2 * HALF * r * (oy * g0 - g2) - k * d_e
    d_A = HALF * (e * (p - g1 + k * g2) + g3 + k * (k * g5 - 2 * g4))
    d_k = 2 * HALF * A * (e * g2 - g4 + k * g5) - oy * d_e
    d_r = HALF * (oy * (oy * g0 - 2 * g2) + g5)
    return d_e, d_oy, d_A, d_k, d_r, g0
