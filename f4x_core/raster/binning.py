"""Tile lists: which splats reach which tile, front to back, exact per tile row and opacity-aware."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .contract import RasterConfig
from .projection import Ellipses, cut

# Relative and absolute widening of the ellipse, so that rounding never drops a pair that still contributes.
SLACK = 1e-4
_SAME_SIZE = {2: torch.int16, 4: torch.int32, 8: torch.int64}


class TileLists(NamedTuple):
    """The (splat, tile) pairs, sorted by tile and front to back inside a tile, padded to blocks of `block` slots."""

    ids: Tensor
    """(B, block) splat of every slot, 0 in padding. Block B - 1 is all padding."""
    padding: Tensor
    """(B, block) bool."""
    tile: Tensor
    """(B,) tile that owns the block."""
    first: Tensor
    """(tiles,) first block of the tile."""
    length: Tensor
    """(tiles,) number of blocks of the tile."""
    slots: Tensor
    """(P,) slot of every pair, splat by splat: the transposed list that gathers gradients."""
    splats: Tensor
    """(V,) visible splats, front to back: the order of `offsets`."""
    offsets: Tensor
    """(V,) start of each splat's run in `slots`."""


@torch.no_grad()
def build_tile_lists(
    ellipses: Ellipses, width: int, height: int, block: int, config: RasterConfig, band: range | None = None
) -> TileLists:
    """List for every `config.tile`-pixel tile the splats whose {alpha >= alpha_min} ellipse reaches its pixel centres.

    `band`: the rows of tiles whose tiles are meant, all when None; the first tile of the first one is tile 0.

    One stable depth sort of the splats, then one stable sort of the pairs by tile, which keeps depth order.
    """
    side = config.tile
    columns, band = -(-width // side), band or range(-(-height // side))
    splats = ellipses.visible.nonzero()[:, 0]
    # Depths are positive, so their bits sort like the numbers: integers take torch's radix sort.
    bits = ellipses.depth.view(_SAME_SIZE[ellipses.depth.element_size()])
    splats = splats[torch.sort(bits[splats], stable=True).indices]

    # Every splat -> the tile rows of its box: Q (splat, row) items, splat by splat.
    row_low, row_count = _box_range(ellipses, 1, splats, height, side)
    row_end = (row_low + row_count).clamp_max(band.stop)
    row_low = row_low.clamp_min(band.start)
    row_count = (row_end - row_low).clamp_min(0)
    item = torch.repeat_interleave(row_count)  # (Q,)
    row = (row_low - _starts(row_count))[item] + torch.arange(len(item), device=item.device)
    item_splat = splats[item]
    left, right = _extent_in_rows(ellipses, item_splat, row * side, ((row + 1) * side).clamp_max(height), config)
    column_low, column_count = _tile_range(left, right, width, side)
    pair = torch.repeat_interleave(column_count)  # (P,) item of every (splat, tile) pair
    number = torch.arange(len(pair), device=pair.device)
    pair_starts = _starts(column_count)
    tile = ((row - band.start) * columns + column_low - pair_starts)[pair] + number

    tile, order = torch.sort(tile.to(torch.int32), stable=True)
    pairs = torch.bincount(tile, minlength=columns * len(band))  # per tile
    length = (pairs + block - 1) // block
    first = _starts(length)
    blocks = int(length.sum()) + 1
    slot = (first * block - _starts(pairs))[tile] + number
    ids = torch.full((blocks * block,), -1, device=tile.device)
    ids[slot] = item_splat[pair[order]]
    slots = torch.empty_like(slot)
    slots[order] = slot
    ids = ids.view(blocks, block)
    return TileLists(
        ids=ids.clamp_min(0),
        padding=ids < 0,
        tile=torch.cat((torch.repeat_interleave(length), length.new_zeros(1))),
        first=first,
        length=length,
        slots=slots,
        splats=splats,
        offsets=torch.cat((pair_starts, pair_starts.new_tensor([len(pair)])))[_starts(row_count)],
    )


def _extent_in_rows(
    ellipses: Ellipses, splats: Tensor, top: Tensor, end: Tensor, config: RasterConfig
) -> tuple[Tensor, Tensor]:
    """Return the least and greatest x (Q,) that the ellipses of `splats (Q,)` reach in the rows of pixels `top` to `end - 1` (Q,).

    An ellipse is convex, so its extreme x over the rows' pixel centres lies at the y of its outermost points, moved into them.
    """
    mx, my, A, k, r, log_opacity = ellipses.table.index_select(1, splats)
    reach = cut(log_opacity, config.alpha_min) * (1 + SLACK) + SLACK
    first, last = top + 0.5 - my, end - 0.5 - my
    outermost = k / r * (reach / (A.reciprocal() + k.square() / r)).sqrt()  # cov_xy sqrt(reach / cov_xx)
    right_y, left_y = (torch.minimum(torch.maximum(y, first), last) for y in (outermost, -outermost))
    right = mx + k * right_y + ((reach - r * right_y.square()).clamp_min(0) / A).sqrt()
    left = mx + k * left_y - ((reach - r * left_y.square()).clamp_min(0) / A).sqrt()
    return left - SLACK, right + SLACK


@torch.no_grad()
def bands_of(ellipses: Ellipses, width: int, height: int, config: RasterConfig, pairs: int) -> list[range]:
    """Cut the rows of tiles into bands whose splats' boxes meet at most `pairs` tiles each, or are one row high."""
    side = config.tile
    splats = ellipses.visible.nonzero()[:, 0]
    (_, across), (row_low, row_count) = (
        _box_range(ellipses, axis, splats, size, side) for axis, size in enumerate((width, height))
    )
    changes = across.new_zeros(-(-height // side) + 1)
    changes.index_add_(0, row_low, across).index_add_(0, row_low + row_count, -across)
    bands, start, total = [], 0, 0
    per_row = changes.cumsum(0)[:-1].tolist()
    for row, count in enumerate(per_row):
        if total + count > pairs and row > start:
            bands.append(range(start, row))
            start, total = row, 0
        total += count
    return [*bands, range(start, len(per_row))]


def _box_range(ellipses: Ellipses, axis: int, splats: Tensor, size: int, side: int) -> tuple[Tensor, Tensor]:
    """Return the first tile and number of tiles along an axis (0 across, 1 down) that the boxes of `splats` meet."""
    centre, half = ellipses.table[axis, splats], ellipses.half_box[axis, splats] * (1 + SLACK) + SLACK
    return _tile_range(centre - half, centre + half, size, side)


def _tile_range(low: Tensor, high: Tensor, size: int, side: int) -> tuple[Tensor, Tensor]:
    """Return the first tile and number of tiles whose pixel centres (i + 0.5, 0 <= i < size) meet the interval [low, high]."""
    first = (low - 0.5).clamp(0, size).ceil()
    last = (high - 0.5).clamp(-1, size - 1).floor()
    tile = (first / side).floor()
    count = torch.where(first <= last, (last / side).floor() - tile + 1, 0)
    return tile.long(), count.long()


def _starts(lengths: Tensor) -> Tensor:
    """Return the start of each run, where runs of these lengths follow each other."""
    return lengths.cumsum(0) - lengths
