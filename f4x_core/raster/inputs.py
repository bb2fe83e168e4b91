"""What goes into `rasterize`: checked, made floating point, and freed of Gaussians that are not finite. Without torch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import F4xError

Arguments = dict[str, Any]
"""The arrays of `rasterize` by name, torch tensors or numpy arrays, None where one was left out."""

PER_GAUSSIAN = ("means", "quats", "scales", "opacities", "colors", "mean2d_offset")


def check_shapes(
    arguments: Arguments, width: int, height: int, detached_from: int | None, rows: slice | None = None
) -> None:
    """Raise F4xError with one sentence where shapes or sizes do not fit together."""
    n = len(arguments["means"])
    channels = arguments["colors"].shape[-1]
    wanted = {
        "means": (n, 3),
        "quats": (n, 4),
        "scales": (n, 3),
        "opacities": (n,),
        "colors": (n, channels),
        "viewmat": (4, 4),
        "K": (3, 3),
        "background": (channels,),
        "mean2d_offset": (n, 2),
        "limit": (height if rows is None else rows.stop - rows.start, width),
    }
    for name, shape in wanted.items():
        if arguments.get(name) is not None and tuple(arguments[name].shape) != shape:
            raise F4xError(f"rasterize: {name} has shape {tuple(arguments[name].shape)}, it must be {shape}.")
    if width < 1 or height < 1:
        raise F4xError(f"rasterize: an image of {width} x {height} pixels cannot be drawn, give at least 1 x 1.")
    if rows is not None and not (0 <= rows.start < rows.stop <= height and rows.step in (None, 1)):
        raise F4xError(
            f"rasterize: rows are {rows}, they must be slice(first, last) with 0 <= first < last <= {height}."
        )
    if detached_from is not None and not 0 <= detached_from <= channels:
        raise F4xError(f"rasterize: detached_from is {detached_from}, it must lie in 0..{channels}.")


def make_floating(arguments: Arguments) -> Arguments:
    """Whole numbers become float32; everything else stays what it is."""

    def convert(array: Any) -> Any:
        if isinstance(array, np.ndarray):
            return array if array.dtype.kind == "f" else array.astype(np.float32)
        return array if array is None or array.is_floating_point() else array.float()

    return {name: convert(array) for name, array in arguments.items()}


def leave_out_broken(arguments: Arguments, debug: bool) -> tuple[Arguments, int]:
    """Make Gaussians with a NaN or infinity among their values transparent, finite and without gradients.

    Returns:
        The arrays, unchanged where nothing is broken, and the number of Gaussians left out.

    Raises:
        F4xError: a broken camera or background, which no picture can do without; with `debug`, any broken value.
    """
    for name in ("viewmat", "K", "background"):
        if not _all_finite(arguments[name]):
            raise F4xError(f"rasterize: {name} holds NaN or infinity, so nothing can be drawn.")
    given = [name for name in PER_GAUSSIAN if arguments.get(name) is not None]
    if all(_all_finite(arguments[name]) for name in given):
        return arguments, 0
    whole = {name: _finite_rows(arguments[name]) for name in given}  # (N,) bool each
    keep = np.logical_and.reduce(list(whole.values()))
    if debug and not keep.all():
        first = int(np.argmin(keep))
        names = [name for name in given if not whole[name][first]]
        raise F4xError(
            f"rasterize: {', '.join(names)} of Gaussian {first} hold NaN or infinity "
            f"({int((~keep).sum())} of {len(keep)} Gaussians are broken)."
        )
    zeroed = {name: _zero_rows(arguments[name], ~keep) for name in given}
    return {**arguments, **zeroed}, int((~keep).sum())


def _detached(array: Any) -> Any:
    return array if isinstance(array, np.ndarray) else array.detach()


def _all_finite(array: Any) -> bool:
    """Whether the sum is finite: one cheap pass that notices every NaN and infinity, and seldom cries wolf (overflow)."""
    if array is None:
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        return math.isfinite(float(_detached(array).sum()))


def _finite_rows(array: Any) -> np.ndarray:
    values = array if isinstance(array, np.ndarray) else array.detach().cpu().numpy()
    return np.isfinite(values).reshape(len(values), -1).all(1)


def _zero_rows(array: Any, rows: np.ndarray) -> Any:
    """A copy with zeros in these rows, differentiable in the others."""
    if isinstance(array, np.ndarray):
        array = array.copy()
        array[rows] = 0
        return array
    index = array.new_tensor(rows).bool()
    return array.masked_fill(index.view(-1, *[1] * (array.dim() - 1)), 0.0)
