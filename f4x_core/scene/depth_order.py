"""Back-to-front order of the Gaussians of several clouds: the compiled radix sort, numpy's where there is no library."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import F4xError
from ..native import open_library
from ..native.binder import FLOAT, INT32, INT64, Array, Function, Struct

EXACT_COUNT = 1 << 24
"""Gaussians that can be drawn: above it a float32 no longer holds every index."""
DEPTH_ORDER = Struct(
    "DepthOrder",
    {
        **dict.fromkeys(("count", "clouds"), INT64),
        **dict.fromkeys(("threads", "coarse"), INT32),
        **dict.fromkeys(("near", "far", "alpha_min"), FLOAT),
        "starts": Array("int64", ("1+clouds",)),
        "rows": Array("float32", ("clouds", 4)),
        "means": Array("float32", ("count", 3)),
        "opacities": Array("float32", ("count",)),
        "order": Array("float32", ("count",), output=True),
    },
)
"""`struct DepthOrder` of order.cpp."""
F4X_DEPTH_ORDER = Function("f4x_depth_order", {"problem": DEPTH_ORDER}, INT64)


@dataclass(frozen=True)
class OrderSettings:
    """Limits of what is sorted, and how exactly."""

    near: float
    """Depth above which a Gaussian is seen."""
    far: float
    """Depth below which it is seen."""
    alpha_min: float
    """Opacity from which on it is seen."""
    coarse: bool = False
    """The highest 12 bits by which depths differ, in one pass: for a view that moves. False = exact."""
    threads: int = 1
    """Threads of the compiled library; never changes the result."""


def depth_order(
    means: np.ndarray,
    opacities: np.ndarray,
    starts: np.ndarray,
    rows: np.ndarray,
    settings: OrderSettings,
    out: np.ndarray,
) -> int:
    """Write the indices of the Gaussians that are seen into `out`, the farthest first; returns their number.

    Of two at one depth the larger index comes first, as in the compositing rule. What is left out is behind `near`, beyond
    `far`, transparent or not finite.

    Args:
        means: (N,3) float32 centres, cloud after cloud, each in its object's frame.
        opacities: (N,) float32.
        starts: (clouds + 1,) int64: the first Gaussian of each cloud, then N.
        rows: (clouds,4) float32: depth is `row . (x, 1)`.
        settings: planes and precision.
        out: (N,) float32, whole numbers below `EXACT_COUNT`.

    Raises:
        F4xError: more than `EXACT_COUNT` Gaussians, arrays that do not fit, or no memory left.
    """
    if len(means) > EXACT_COUNT:
        raise F4xError(f"depth order: {len(means):,} Gaussians are too many, {EXACT_COUNT:,} can be drawn; hide some.")
    library, _ = open_library()
    if library is None:
        return _with_numpy(means, opacities, starts, rows, settings, out)
    problem = DEPTH_ORDER(
        count=len(means),
        clouds=len(rows),
        threads=settings.threads,
        coarse=int(settings.coarse),
        near=settings.near,
        far=settings.far,
        alpha_min=settings.alpha_min,
        starts=starts,
        rows=rows,
        means=means,
        opacities=opacities,
        order=out,
    )
    found = int(F4X_DEPTH_ORDER(problem, library=library))
    if found < 0:
        raise F4xError("depth order: there is not enough memory; hide some Gaussians.")
    return found


def _with_numpy(
    means: np.ndarray,
    opacities: np.ndarray,
    starts: np.ndarray,
    rows: np.ndarray,
    settings: OrderSettings,
    out: np.ndarray,
) -> int:
    """Return `depth_order` in numpy alone; always exact."""
    depth = np.empty(len(means), np.float32)
    for row, first, last in zip(rows, starts, starts[1:], strict=False):
        depth[first:last] = means[first:last] @ row[:3] + row[3]
    seen = np.flatnonzero((depth > settings.near) & (depth < settings.far) & (opacities >= settings.alpha_min))
    out[: len(seen)] = seen[np.argsort(depth[seen], kind="stable")][::-1]
    return len(seen)
