"""Native raster backend. Imports torch only when tensors come in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from ..contract import RasterConfig, RasterOutput
from .library import forward, open_library

if TYPE_CHECKING:
    from ..contract import Array

__all__ = ["available", "forward_numpy", "rasterize_native", "why_not"]


def available() -> bool:
    """Whether a library built from the present source is there, loads, and agrees with its stored float64 values."""
    return open_library()[0] is not None


def why_not() -> str:
    """Why `available` is False, as part of a sentence; empty when it is True."""
    return open_library()[1]


def rasterize_native(
    means: Array,
    quats: Array,
    scales: Array,
    opacities: Array,
    colors: Array,
    viewmat: Array,
    K: Array,
    width: int,
    height: int,
    *,
    background: Array | None = None,
    config: RasterConfig | None = None,
    detached_from: int | None = None,
    mean2d_offset: Array | None = None,
    limit: Array | None = None,
    rows: slice | None = None,
) -> RasterOutput:
    """`raster.rasterize` by the native kernel; tensors must be float32 on the CPU and can be differentiated once.

    Tiles are always 16 x 16 (`config.tile` is not used). Results and gradients are the same bit for bit for every
    `config.threads`.

    Raises:
        F4xError: the kernel is not available, or a tensor has another dtype or device.
    """
    if isinstance(means, np.ndarray):
        return forward_numpy(
            means, quats, scales, opacities, colors, viewmat, K, width, height,
            background=background, config=config, mean2d_offset=mean2d_offset, limit=limit, rows=rows,
        )  # fmt: skip
    from .autograd import rasterize_tensors

    _library()
    arguments: dict[str, Any] = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "colors": colors,
        "viewmat": viewmat,
        "K": K,
        "background": background,
        "mean2d_offset": mean2d_offset,
        "limit": limit,
    }
    return rasterize_tensors(arguments, width, height, config or RasterConfig(), detached_from, rows)


def forward_numpy(
    means: Array,
    quats: Array,
    scales: Array,
    opacities: Array,
    colors: Array,
    viewmat: Array,
    K: Array,
    width: int,
    height: int,
    *,
    background: Array | None = None,
    config: RasterConfig | None = None,
    mean2d_offset: Array | None = None,
    limit: Array | None = None,
    rows: slice | None = None,
) -> RasterOutput:
    """`raster.rasterize` without gradients: numpy arrays of any dtype in (computed in float32), float32 arrays out.

    Raises:
        F4xError: the kernel is not available.
    """
    inputs = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "colors": colors,
        "viewmat": viewmat,
        "K": K,
        "background": background,
        "mean2d_offset": mean2d_offset,
        "limit": limit,
    }
    return forward(_library(), inputs, width, height, config or RasterConfig(), None, keep=False, rows=rows).output


def _library() -> Any:
    library, reason = open_library()
    if library is None:
        raise F4xError(f"The native raster backend cannot run here ({reason}): use backend='torch'.")
    return library
