"""Checks the input of `rasterize`, makes it floating point, and drops Gaussians that are not finite. Without torch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import like
from .contract import RasterInput

PER_GAUSSIAN = ("means", "quats", "scales", "opacities", "colors", "mean2d_offset")


def prepare(given: RasterInput, unseen: bool = False) -> tuple[RasterInput, int]:
    """Return the input of a backend: checked, floating point, the camera in the kind of the Gaussians, nothing broken left.

    `unseen`: leave it to the backend to find broken Gaussians.

    Returns:
        The input, and the number of Gaussians that are left out: transparent, finite and without gradients.

    Raises:
        F4xError: shapes that do not fit, a broken camera or background; with `config.debug`, any broken value.
    """
    arrays = given.arrays()
    _check_shapes(given, arrays)
    floating = {name: _floating(array) for name, array in arrays.items()}
    of_the_view = [name for name in ("viewmat", "K", "background") if floating[name] is not None]
    floating |= {name: like(floating[name], floating["means"]) for name in of_the_view}
    whole, dropped = _leave_out_broken(floating, given.config.debug, unseen)
    return given.with_arrays(whole), dropped


def _check_shapes(given: RasterInput, arrays: dict[str, Any]) -> None:
    """Raise F4xError with one sentence where shapes or sizes do not fit together."""
    n, channels = len(given.splats), given.colors.shape[-1]
    width, height, rows = given.camera.width, given.camera.height, given.drawn_rows
    wanted = {
        "means": (n, 3),
        "quats": (n, 4),
        "scales": (n, 3),
        "opacities": (n,),
        "colors": (n, channels),
        "background": (channels,),
        "mean2d_offset": (n, 2),
        "limit": (rows.stop - rows.start, width),
    }
    for name, shape in wanted.items():
        if arrays[name] is not None and tuple(arrays[name].shape) != shape:
            raise F4xError(f"rasterize: {name} has shape {tuple(arrays[name].shape)}, it must be {shape}.")
    if not (0 <= rows.start < rows.stop <= height and rows.step in (None, 1)):
        raise F4xError(
            f"rasterize: rows are {rows}, they must be slice(first, last) with 0 <= first < last <= {height}."
        )
    if not 0 <= given.attached_channels <= channels:
        raise F4xError(f"rasterize: detached_from is {given.detached_from}, it must lie in 0..{channels}.")


def _floating(array: Any) -> Any:
    """Return whole numbers as float32, and everything else as it is."""
    if isinstance(array, np.ndarray):
        return array if array.dtype.kind == "f" else array.astype(np.float32)
    return array if array is None or array.is_floating_point() else array.float()


def _leave_out_broken(arrays: dict[str, Any], debug: bool, unseen: bool) -> tuple[dict[str, Any], int]:
    """Make Gaussians with a NaN or infinity among their values transparent, finite and without gradients; count them."""
    for name in ("viewmat", "K", "background"):
        if not _all_finite(arrays[name]):
            raise F4xError(f"rasterize: {name} holds NaN or infinity, so nothing can be drawn.")
    given = [name for name in PER_GAUSSIAN if arrays[name] is not None]
    if unseen or all(_all_finite(arrays[name]) for name in given):
        return arrays, 0
    whole = {name: _finite_rows(arrays[name]) for name in given}  # (N,) bool each
    keep = np.logical_and.reduce(list(whole.values()))
    if debug and not keep.all():
        first = int(np.argmin(keep))
        names = [name for name in given if not whole[name][first]]
        raise F4xError(
            f"rasterize: {', '.join(names)} of Gaussian {first} hold NaN or infinity "
            f"({int((~keep).sum())} of {len(keep)} Gaussians are broken)."
        )
    zeroed = {name: _zero_rows(arrays[name], ~keep) for name in given}
    return {**arrays, **zeroed}, int((~keep).sum())


def _detached(array: Any) -> Any:
    return array if isinstance(array, np.ndarray) else array.detach()


def _all_finite(array: Any) -> bool:
    """Return True if the sum is finite: one cheap pass that notices every NaN and infinity; it fails seldom by overflow."""
    if array is None:
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        return math.isfinite(float(_detached(array).sum()))


def _finite_rows(array: Any) -> np.ndarray:
    values = array if isinstance(array, np.ndarray) else array.detach().cpu().numpy()
    return np.isfinite(values).reshape(len(values), -1).all(1)


def _zero_rows(array: Any, rows: np.ndarray) -> Any:
    """Return a copy with zeros in these rows, differentiable in the others."""
    if isinstance(array, np.ndarray):
        array = array.copy()
        array[rows] = 0
        return array
    index = array.new_tensor(rows).bool()
    return array.masked_fill(index.view(-1, *[1] * (array.dim() - 1)), 0.0)
