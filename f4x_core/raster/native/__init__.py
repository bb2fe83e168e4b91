"""Native raster backend. Imports torch only when tensors come in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import F4xError
from ..contract import RasterInput, RasterOutput
from .library import backward, forward, open_library

__all__ = ["available", "color_gradients", "rasterize_native", "why_not"]


def available() -> bool:
    """Return True if a library of the present source loads and agrees with its stored float64 values."""
    return open_library()[0] is not None


def why_not() -> str:
    """Return why `available` is False, as part of a sentence; empty when it is True."""
    return open_library()[1]


def rasterize_native(inputs: RasterInput) -> RasterOutput:
    """Return `raster.rasterize` by the native kernel; tensors must be float32 on the CPU and can be differentiated once.

    Tiles are always 16 x 16 (`config.tile` is not used). Results and gradients are the same bit for bit for every
    `config.threads`. Numpy arrays of any dtype are drawn in float32.

    Raises:
        F4xError: the kernel is not available, or a tensor has another dtype or device.
    """
    library = _library()
    if isinstance(inputs.splats.means, np.ndarray):
        return forward(library, inputs, keep=False).output
    from .autograd import rasterize_tensors

    return rasterize_tensors(inputs)


def color_gradients(inputs: RasterInput) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that gives the gradient (N,C) float32 of the colours of numpy `inputs` for that of the image (H,W,C).

    What is drawn is drawn once, however often the function is called.

    Raises:
        F4xError: the kernel is not available.
    """
    library = _library()
    render = forward(library, inputs, keep=True)
    return lambda sent: backward(library, render, sent, None, None)["colors"]


def _library() -> Any:
    library, reason = open_library()
    if library is None:
        raise F4xError(f"The native raster backend cannot run here ({reason}): use backend='torch'.")
    return library
