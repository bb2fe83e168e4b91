"""The `torch` backend: tile-wise alpha compositing as batched GEMMs with a hand-written backward; any device and dtype.

A tile's front-to-back list is cut into slabs of `SLAB` splats. For a batch of tiles, one slab is a dense block
(tiles, pixels, splats): log2 alpha is a 6-term polynomial of the pixel's place in the tile (one bmm), one cumprod gives
transmittance, blending weights and stop rule at once, and channels are contracted by a second bmm.
Batches are independent and each writes its own rows, so the number of threads never changes a bit of the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .binning import TileLists, build_tile_lists
from .contract import RasterConfig, RasterOutput
from .projection import project

# Splats blended at once; a tile stops between slabs. 32 keeps slabs full and wastes little after the stop.
SLAB = 32
# Pixels x splats worked on at once: large enough to hide call overhead, small enough to stay in the CPU's cache.
ELEMENTS_CPU, ELEMENTS_ACCELERATOR = 2**17, 2**23
# A batch drops finished tiles as soon as fewer than this share of it is still at work.
COMPACT_BELOW = 0.85
# log2 alpha of a padding slot: 2^-1000 is 0 in every float type.
PADDING = -1000.0
# q / -2 in base 2: alpha = 2^(log2 opacity + HALF q).
HALF = -0.5 / math.log(2)


def rasterize_torch(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    background: Tensor | None = None,
    config: RasterConfig | None = None,
    detached_from: int | None = None,
    mean2d_offset: Tensor | None = None,
) -> RasterOutput:
    """Composite Gaussians; arguments and result as in `rasterize`, tensors only."""
    config = config or RasterConfig()
    viewmat, K = viewmat.to(means), K.to(means)
    ellipses = project(means, quats, scales, opacities, viewmat, K, width, height, config, mean2d_offset)
    lists = build_tile_lists(ellipses, width, height, SLAB, config)
    features = torch.cat((torch.ones_like(ellipses.depth)[:, None], ellipses.depth[:, None], colors), 1)
    attached = 2 + (colors.shape[1] if detached_from is None else detached_from)
    canvas = _Canvas(width, height, config)
    channels, depth, alpha = _Composite.apply(ellipses.table, features, lists, canvas, attached)
    if background is not None:
        channels = add_background(channels, alpha, background.to(means), detached_from)
    return RasterOutput(channels, depth, alpha, ellipses.visible)


def add_background(channels: Tensor, alpha: Tensor, background: Tensor, detached_from: int | None) -> Tensor:
    """channels (H, W, C) plus background (C,) times the light left, 1 - alpha (H, W).

    Channels from `detached_from` on send no gradient to alpha.
    """
    light = (1 - alpha)[..., None]
    if detached_from is None:
        return channels + light * background
    kept = channels[..., :detached_from] + light * background[:detached_from]
    rest = channels[..., detached_from:] + light.detach() * background[detached_from:]
    return torch.cat((kept, rest), -1)


class _Canvas:
    """Geometry of the tile grid."""

    def __init__(self, width: int, height: int, config: RasterConfig):
        self.width, self.height, self.config, self.side = width, height, config, config.tile
        self.columns, self.rows = -(-width // self.side), -(-height // self.side)
        self.pixels = self.side**2

    def basis(self, like: Tensor) -> Tensor:
        """(6, pixels) monomials 1, u, v, u^2, uv, v^2 of a pixel's place relative to the tile centre."""
        axis = torch.arange(self.side, dtype=like.dtype, device=like.device) + 0.5 - self.side / 2
        v, u = (c.reshape(-1) for c in torch.meshgrid(axis, axis, indexing="ij"))
        return torch.stack((torch.ones_like(u), u, v, u * u, u * v, v * v))

    def centres(self, tile: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
        """x and y of tile centres, pixels."""
        x, y = tile % self.columns, tile // self.columns
        return ((c.to(like.dtype) + 0.5) * self.side for c in (x, y))  # type: ignore[return-value]

    def to_image(self, tiles: Tensor) -> Tensor:
        """(tiles, C, pixels) -> (C, H, W)."""
        grid = tiles.view(self.rows, self.columns, -1, self.side, self.side).permute(2, 0, 3, 1, 4)
        image = grid.reshape(-1, self.rows * self.side, self.columns * self.side)
        return image[:, : self.height, : self.width]

    def to_tiles(self, image: Tensor) -> Tensor:
        """(C, H, W) -> (tiles, C, pixels), 0 outside the image."""
        image = F.pad(image, (0, self.columns * self.side - self.width, 0, self.rows * self.side - self.height))
        grid = image.view(-1, self.rows, self.side, self.columns, self.side).permute(1, 3, 0, 2, 4)
        return grid.reshape(self.rows * self.columns, -1, self.pixels)


class _Step(NamedTuple):
    """One slab of one batch of tiles, as the backward pass needs it again."""

    tiles: Tensor
    """(t,)"""
    blocks: Tensor
    """(t,) block of `TileLists` that every tile blends."""
    light: Tensor
    """(t, pixels) transmittance in front of the slab, 0 where the pixel has stopped."""


class _Composite(torch.autograd.Function):
    """table (6, N), features (N, 2 + C) whose columns are 1, z, colors -> channels (H, W, C), depth, alpha (H, W)."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, table: Tensor, features: Tensor, lists: TileLists, canvas: _Canvas, attached: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        theta = _polynomials(table, lists, canvas)
        basis = canvas.basis(table)
        recording = any(ctx.needs_input_grad[:2])
        out = features.new_zeros(len(lists.count), features.shape[1], canvas.pixels)
        steps = _run(
            lambda tiles, work: _blend(tiles, work, theta, basis, features, lists, canvas, out, recording),
            _batches(lists, canvas, table),
            canvas,
            table,
        )
        if recording:
            ctx.save_for_backward(table, features, theta)
            ctx.lists, ctx.canvas, ctx.attached, ctx.steps = lists, canvas, attached, steps
            ctx.set_materialize_grads(False)
        image = canvas.to_image(out)
        return image[2:].permute(1, 2, 0), image[1], image[0]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        table, features, theta = ctx.saved_tensors
        lists, canvas = ctx.lists, ctx.canvas
        grad_image = features.new_zeros(features.shape[1], canvas.height, canvas.width)
        for target, grad in zip((grad_image[2:], grad_image[1], grad_image[0]), grads, strict=True):
            if grad is not None:
                target.copy_(grad.permute(2, 0, 1) if grad.dim() == 3 else grad)
        grad_tiles = canvas.to_tiles(grad_image)
        grad_table, grad_features = _differentiate(
            ctx.steps, grad_tiles, table, features, theta, lists, canvas, ctx.attached
        )
        return grad_table, grad_features, None, None, None


class _Work:
    """Buffers of one thread, grown once and then reused for every slab: (t, pixels, splats) views of flat memory."""

    def __init__(self) -> None:
        self._flat: dict[str, Tensor] = {}

    def __call__(self, name: str, like: Tensor, *shape: int) -> Tensor:
        size = math.prod(shape)
        if name not in self._flat or len(self._flat[name]) < size:
            self._flat[name] = like.new_empty(size)
        return self._flat[name][:size].view(shape)


def _run(task: Callable[[Any, _Work], Any], items: Iterable[Any], canvas: _Canvas, like: Tensor) -> list[Any]:
    """`[task(item, work) for item in items]`, on `config.threads` threads on the CPU."""
    items = list(items)
    threads = min(canvas.config.threads, len(items)) if like.device.type == "cpu" else 1
    if threads <= 1:
        work = _Work()
        return [task(item, work) for item in items]
    queue, results = iter(enumerate(items)), [None] * len(items)

    def drain() -> None:
        # Intra-op threads inside these threads would only fight over the same cores.
        torch.set_num_threads(1)
        work = _Work()
        with torch.no_grad():
            for index, item in queue:
                results[index] = task(item, work)

    intra_op = torch.get_num_threads()
    try:
        with ThreadPoolExecutor(threads) as pool:
            for future in [pool.submit(drain) for _ in range(threads)]:
                future.result()
    finally:
        torch.set_num_threads(intra_op)
    return results


def _batches(lists: TileLists, canvas: _Canvas, like: Tensor) -> list[Tensor]:
    """Tiles with anything to blend, in batches of similar list length."""
    elements = ELEMENTS_CPU if like.device.type == "cpu" else ELEMENTS_ACCELERATOR
    order = torch.argsort(lists.count, descending=True, stable=True)[: int((lists.count > 0).sum())]
    return list(order.split(max(1, elements // (SLAB * canvas.pixels)))) if len(order) else []


def _polynomials(table: Tensor, lists: TileLists, canvas: _Canvas) -> Tensor:
    """(B, 6, SLAB) coefficients of log2 alpha over `_Canvas.basis` for every slot."""
    oy, e, A, k, r, log_opacity = _local(table, lists, canvas)
    Ae, ro = A * e, r * oy
    theta = table.new_empty(len(lists.ids), 6, SLAB)
    theta[:, 0] = (log_opacity + HALF * (Ae * e + ro * oy)).masked_fill_(lists.padding, PADDING)
    theta[:, 1] = Ae * (-2 * HALF)
    theta[:, 2] = (k * Ae - ro) * (2 * HALF)
    theta[:, 3] = A * HALF
    theta[:, 4] = A * k * (-2 * HALF)
    theta[:, 5] = (A * k * k + r) * HALF
    return theta


def _local(table: Tensor, lists: TileLists, canvas: _Canvas) -> tuple[Tensor, ...]:
    """(B, SLAB) each: offset of the mean from the tile centre in y, e = ox - k oy, then A, k, r, log2 opacity."""
    mx, my, A, k, r, log_opacity = table.index_select(1, lists.ids.view(-1)).view(6, -1, SLAB)
    x, y = canvas.centres(lists.tile[:, None], table)
    oy = my - y
    return oy, (mx - x) - k * oy, A, k, r, log_opacity


def _blend(tiles, work, theta, basis, features, lists, canvas, out, recording) -> list[_Step]:
    """Composite a batch of tiles front to back into their rows of `out`."""
    first, count = lists.first[tiles], lists.count[tiles]
    light = theta.new_ones(len(tiles), canvas.pixels)
    total = theta.new_zeros(len(tiles), features.shape[1], canvas.pixels)
    steps = []
    for level in range(int(count[0])):
        alive = (count > level) & (light.amax(1) > 0)
        living = int(alive.sum())
        if living < COMPACT_BELOW * len(tiles):
            out[tiles] = total
            if living == 0:
                return steps
            tiles, first, count, light, total = (x[alive] for x in (tiles, first, count, light, total))
            alive = alive[alive]
        blocks = torch.where(alive, first + level, len(lists.ids) - 1)
        if recording:
            steps.append(_Step(tiles, blocks, light))
        _, weights, _, light = _weights(blocks, work, theta, basis, light, canvas.config)
        gathered = F.embedding(lists.ids[blocks], features)  # (t, SLAB, 2 + C)
        total.baddbmm_(gathered.transpose(1, 2), weights.transpose(1, 2))
    out[tiles] = total
    return steps


def _weights(blocks, work, theta, basis, light, config) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Blend one slab: 1 - alpha, weights alpha T, ratio alpha / (1 - alpha), each (t, pixels, SLAB), and light after it."""
    shape = (len(blocks), basis.shape[1], SLAB)
    alpha, keep, after = (work(name, theta, *shape) for name in ("alpha", "keep", "after"))
    torch.bmm(basis.t().expand(len(blocks), -1, -1), theta.index_select(0, blocks), out=alpha)
    F.threshold_(alpha.exp2_(), config.alpha_min, 0.0).clamp_max_(config.alpha_max)
    torch.sub(theta.new_ones(()), alpha, out=keep)
    torch.cumprod(keep, -1, out=after)
    # The product never rises, so cutting it behind the last blended splat also cuts everything behind the stop.
    last = F.threshold_(after.mul_(light[..., None]), config.transmittance_min, 0.0)[..., -1].clone()
    ratio = alpha.div_(keep)
    return keep, after.mul_(ratio), ratio, last


def _differentiate(steps, grad_tiles, table, features, theta, lists, canvas, attached) -> tuple[Tensor, Tensor]:
    """Gradients of table (6, N) and features (N, 2 + C) from those of the tiles (tiles, 2 + C, pixels)."""
    config, channels = canvas.config, features.shape[1]
    sizes = [sum(len(step.tiles) for step in batch) for batch in steps]
    ends = torch.tensor([0, *sizes]).cumsum(0).tolist()
    blocks = ends[-1]
    grad_theta = theta.new_empty(blocks, 6, SLAB)
    grad_rows = theta.new_empty(blocks * SLAB + 1, channels)
    grad_rows[-1] = 0
    basis = canvas.basis(table)
    moments = basis * math.log(2)
    clamped = float(1 - table.new_tensor(config.alpha_max))

    def task(item, work: _Work) -> None:
        batch, end = item
        behind = tiles = None
        for step in reversed(batch):
            t = len(step.tiles)
            begin = end - t
            if tiles is not step.tiles:
                carried = theta.new_zeros(t, canvas.pixels)
                if behind is not None:
                    carried[torch.isin(step.tiles, tiles)] = behind
                behind, tiles, grad = carried, step.tiles, grad_tiles[step.tiles]
            keep, weights, ratio, _ = _weights(step.blocks, work, theta, basis, step.light, config)
            gathered = F.embedding(lists.ids[step.blocks], features)
            # d out / d log alpha_i = w_i S_i - ratio_i sum_{j > i} w_j S_j, with S = features . grad
            shaded = work("shaded", theta, *weights.shape)
            torch.bmm(grad[:, :attached].transpose(1, 2), gathered[..., :attached].transpose(1, 2), out=shaded)
            shaded.mul_(weights)
            suffix = torch.cumsum(shaded, -1, out=work("suffix", theta, *weights.shape))
            behind = behind + suffix[..., -1]
            suffix.sub_(behind[..., None]).mul_(ratio).add_(shaded)
            torch.ops.aten.threshold_backward.grad_input(suffix, keep, clamped, grad_input=suffix)
            torch.bmm(moments.expand(t, -1, -1), suffix, out=grad_theta[begin:end])
            rows = torch.bmm(grad, weights, out=work("rows", theta, t, channels, SLAB))
            grad_rows[begin * SLAB : end * SLAB].view(t, SLAB, channels).copy_(rows.transpose(1, 2))
            end = begin

    _run(task, zip(steps, ends[1:], strict=True), canvas, table)

    # Where every slot's row lies; slots that nobody reached point at the row of zeros.
    place = lists.first.new_full((len(lists.ids),), blocks)
    done = torch.cat([step.blocks for batch in steps for step in batch]) if blocks else place[:0]
    place[done] = torch.arange(blocks, device=place.device)
    rows = (place[lists.slots // SLAB] * SLAB + lists.slots % SLAB).clamp_max_(blocks * SLAB)
    grad_table, grad_features = torch.zeros_like(table), torch.zeros_like(features)
    if blocks:
        reached = lists._replace(ids=lists.ids[done], tile=lists.tile[done])
        grad_local = theta.new_zeros(blocks * SLAB + 1, 6)
        grad_local[:-1].view(-1, SLAB, 6).copy_(_pull_back(grad_theta, table, reached, canvas))
        grad_table[:, lists.splats] = F.embedding_bag(rows, grad_local, lists.offsets, mode="sum").t()
        grad_features[lists.splats] = F.embedding_bag(rows, grad_rows, lists.offsets, mode="sum")
    return grad_table, grad_features


def _pull_back(grad_theta: Tensor, table: Tensor, lists: TileLists, canvas: _Canvas) -> Tensor:
    """Gradients of `_polynomials`' coefficients (b, 6, SLAB) -> gradients of the slots' table columns (b, SLAB, 6)."""
    oy, e, A, k, r, _ = _local(table, lists, canvas)
    g0, g1, g2, g3, g4, g5 = grad_theta.unbind(1)
    p = e * g0 - g1 + k * g2
    d_e = 2 * HALF * A * p
    d_oy = 2 * HALF * r * (oy * g0 - g2) - k * d_e
    d_A = HALF * (e * (p - g1 + k * g2) + g3 + k * (k * g5 - 2 * g4))
    d_k = 2 * HALF * A * (e * g2 - g4 + k * g5) - oy * d_e
    d_r = HALF * (oy * (oy * g0 - 2 * g2) + g5)
    return torch.stack((d_e, d_oy, d_A, d_k, d_r, g0), -1)
