"""Tile lists: which splats reach which tile, front to back, exact per tile row and opacity-aware."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .contract import RasterConfig
from .projection import Ellipses, cut

# Relative and absolute widening of the ellipse, so that rounding never drops a pair that still contributes.
SLACK = 1e-4


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
    count: Tensor
    """(tiles,) number of blocks of the tile."""
    slots: Tensor
    """(P,) slot of every pair, splat by splat: the transposed list that gathers gradients."""
    splats: Tensor
    """(V,) visible splats, front to back: the order of `offsets`."""
    offsets: Tensor
    """(V,) start of each splat's run in `slots`."""


@torch.no_grad()
def build_tile_lists(ellipses: Ellipses, width: int, height: int, block: int, config: RasterConfig) -> TileLists:
    """List for every `config.tile`-pixel tile the splats whose {alpha >= alpha_min} ellipse reaches its pixel centres.

    One stable depth sort of the splats, then one stable sort (radix) of the pairs by tile keeps depth order.
    """
    side = config.tile
    columns, rows = -(-width // side), -(-height // side)
    splats = ellipses.visible.nonzero()[:, 0]
    splats = splats[torch.argsort(ellipses.depth[splats], stable=True)]
    mx, my, A, k, r, log_opacity = ellipses.table[:, splats]
    half_x, half_y = ellipses.half_box[:, splats] * (1 + SLACK) + SLACK
    reach = cut(log_opacity, config.alpha_min) * (1 + SLACK) + SLACK

    # Every splat -> the tile rows of its box.
    low, rows_of = _tile_range(my - half_y, my + half_y, height, side)
    owner = torch.repeat_interleave(rows_of)  # (Q,)
    row = low[owner] + _position_in_run(rows_of, owner)
    # Every (splat, row) -> the tile columns its ellipse covers inside that row: the ellipse is convex, so its extreme x
    # over the row lies at the extreme of the whole ellipse, moved into the row.
    mx_q, my_q, A_q, k_q, r_q, reach_q = (c[owner] for c in (mx, my, A, k, r, reach))
    top = row * side + 0.5 - my_q
    bottom = ((row + 1) * side).clamp_max(height) - 0.5 - my_q
    # y of the right-most point: k x_max cov_yy / cov_xx, with cov_xx = 1/A + k^2/r
    extreme = k_q / r_q * (reach_q / (A_q.reciprocal() + k_q.square() / r_q)).sqrt()
    right_y, left_y = (torch.minimum(torch.maximum(y, top), bottom) for y in (extreme, -extreme))
    right = mx_q + k_q * right_y + ((reach_q - r_q * right_y.square()).clamp_min(0) / A_q).sqrt()
    left = mx_q + k_q * left_y - ((reach_q - r_q * left_y.square()).clamp_min(0) / A_q).sqrt()
    low, columns_of = _tile_range(left - SLACK, right + SLACK, width, side)
    pair = torch.repeat_interleave(columns_of)  # (P,)
    tile = (row * columns + low)[pair] + _position_in_run(columns_of, pair)

    order = torch.sort(tile.to(torch.int32), stable=True).indices
    length = torch.bincount(tile, minlength=columns * rows)
    count = (length + block - 1) // block
    first = count.cumsum(0) - count
    blocks = int(count.sum()) + 1
    sorted_tile = tile[order]
    slot = first[sorted_tile] * block + _position_in_run(length, sorted_tile)
    ids = torch.full((blocks * block,), -1, device=tile.device)
    pair_splat = owner[pair]
    ids[slot] = splats[pair_splat[order]]
    slots = torch.empty_like(slot)
    slots[order] = slot
    runs = torch.bincount(pair_splat, minlength=len(splats))
    padding = (ids < 0).view(blocks, block)
    owner_tile = torch.cat((torch.repeat_interleave(count), count.new_zeros(1)))
    return TileLists(
        ids.clamp_min(0).view(blocks, block), padding, owner_tile, first, count, slots, splats, runs.cumsum(0) - runs
    )


def _tile_range(low: Tensor, high: Tensor, size: int, side: int) -> tuple[Tensor, Tensor]:
    """First tile and number of tiles whose pixel centres (i + 0.5, 0 <= i < size) meet the interval [low, high]."""
    first = (low - 0.5).clamp(0, size).ceil().long()
    last = (high - 0.5).clamp(-1, size - 1).floor().long()
    tile = first // side
    return tile, torch.where(first <= last, last // side - tile + 1, 0)


def _position_in_run(lengths: Tensor, run: Tensor) -> Tensor:
    """0, 1, 2 ... inside every run of consecutive equal values of `run`, given the runs' lengths."""
    return torch.arange(len(run), device=run.device) - (lengths.cumsum(0) - lengths)[run]
