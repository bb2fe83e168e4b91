"""Rasteriser: composites any number of channels of 3D Gaussians front to back, with gradients.

Five backends, each for a case that no other one covers:

* `native`: compiled, float32 on the CPU, with gradients. What `auto` takes.
* `gsplat`: float32 on CUDA, with gradients.
* `reference`: a loop over pixels in float64, with gradients. The others are tested against it.
* `torch`: gradients for any dtype and device where neither of the first two runs: no library for the platform, no compiler, a
  failed self-check, CUDA without gsplat. One step on 20,000 Gaussians and 120 x 68 pixels takes .01 s of processor by `native`,
  .9 s by `torch` and 40 s by `reference`: without it nothing could be fitted there.
* `plain`: numpy alone, pictures without gradients. Blender's own Python has no torch, and no library on some platforms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from .contract import NotFiniteError, RasterConfig, RasterInput, RasterOutput
from .inputs import prepare

__all__ = [
    "BACKENDS",
    "CPU_BACKENDS",
    "RasterConfig",
    "RasterInput",
    "RasterOutput",
    "choose_backend",
    "rasterize",
    "why_not",
]

CPU_BACKENDS = ("native", "torch", "reference")
"""Backends that render tensors on the CPU; all of `f4x` offers them."""
BACKENDS = (*CPU_BACKENDS, "gsplat")
"""Backends with gradients; `plain` draws pictures only."""
DRAW_PARTS = ("native", "reference", "plain")


def rasterize(
    splats: Splats,
    colors: Array,
    camera: Camera,
    *,
    background: Array | None = None,
    config: RasterConfig | None = None,
    backend: str = "auto",
    detached_from: int | None = None,
    mean2d_offset: Array | None = None,
    limit: Array | None = None,
    rows: slice | None = None,
) -> RasterOutput:
    """Composite N Gaussians into an image of C channels (EWA splatting, 3DGS rules).

    As in `gsplat.rasterization`, every option is a keyword of its own; `RasterInput` gathers them for the backends.

    Args:
        splats: N Gaussians; their harmonics are not looked at.
        colors: (N, C) any channels: rgb, latent features, ...
        camera: the view, H x W pixels; matrices of numpy serve tensors, too.
        background: (C,) added where light is left; none = black.
        config: constants of the rule and thread count.
        backend: `auto`, one of `BACKENDS`, or `plain`. `auto` takes `native` for float32 on the CPU when it is there and
            agrees with its self-check, `gsplat` for float32 on CUDA where that package is installed, else `torch`; for
            numpy arrays `plain` where torch is not installed, or a `limit` or `rows` are given.
        detached_from: channels from this index on send no gradient to opacity, geometry or camera, only to `colors`.
        mean2d_offset: (N, 2) added to the projected means, in pixels; pass zeros to read the density-control statistic
            from its gradient.
        limit: (H, W) depth from which on a pixel sees nothing: the z of an opaque surface, infinity for none, 0 for a
            pixel that need not be drawn. A Gaussian counts as a whole, by the z of its centre. Not for `torch`, `gsplat`.
        rows: slice(first, last) of the image to draw: H is `last - first` for `limit` and for what comes out, which is what
            the whole image has there, bit for bit. Not for `torch`, `gsplat`.

    Tensors (any dtype, one device; whole numbers count as float32) give tensors with gradients to the arrays of `splats`,
    colors, the camera's matrix, background and mean2d_offset; numpy arrays give numpy arrays, without gradients.
    `reference` answers in float64 always.

    A Gaussian with a NaN or infinity among its values is left out and counted in `dropped`.

    Raises:
        F4xError: shapes that do not fit, a camera that is not finite, an unknown backend, one that is not installed or that
            cannot do what is asked for; with `config.debug` also Gaussians that are not finite.
    """
    config = config or RasterConfig()
    optional = {"background": background, "mean2d_offset": mean2d_offset, "limit": limit}
    given = RasterInput(splats, colors, camera, **optional, config=config, detached_from=detached_from, rows=rows)
    inputs, dropped = prepare(given, unseen=True)
    chosen = choose_backend(backend, inputs.splats.means, partial=limit is not None or rows is not None)
    function = backend_function(chosen)
    if chosen == "native":  # looks itself, on all threads
        try:
            return function(inputs)
        except NotFiniteError:
            pass
    inputs, dropped = prepare(given)
    if chosen not in ("native", "plain") and isinstance(inputs.splats.means, np.ndarray):
        out = _through_numpy(function, inputs)
    else:
        out = function(inputs)
    return replace(out, dropped=dropped) if dropped else out


def backend_function(name: str) -> Callable[[RasterInput], RasterOutput]:
    """Return the function of a backend, imported when it is used."""
    if name == "native":
        from .native import rasterize_native as function
    elif name == "reference":
        from .reference import rasterize_reference as function
    elif name == "gsplat":
        from .gsplat import rasterize_gsplat as function
    elif name == "plain":
        from .plain import rasterize_plain as function
    else:
        from .tiles import rasterize_torch as function
    return function


def choose_backend(backend: str, means: Array | None = None, *, partial: bool = False) -> str:
    """Return the name of the backend that `backend` stands for, given the means to be drawn and whether there are limits or rows.

    Raises:
        F4xError: an unknown name, or a backend that cannot run here (the sentence says why).
    """
    in_numpy = isinstance(means, np.ndarray)
    if backend == "auto":
        single = str(getattr(means, "dtype", "float32")).endswith("float32")
        device = str(getattr(means, "device", "cpu")).partition(":")[0]
        fastest = {"cpu": "native", "cuda": "gsplat"}.get(device)
        if single and fastest and why_not(fastest) is None and (fastest in DRAW_PARTS or not partial):
            return fastest
        if in_numpy and (partial or not find_spec("torch")):
            return "plain"
        return "reference" if partial else "torch"
    if backend not in (*BACKENDS, "plain"):
        raise F4xError(f"Unknown raster backend '{backend}': use auto, {', '.join(BACKENDS)} or plain.")
    if backend == "plain" and not (in_numpy or means is None):
        raise F4xError("The plain raster backend takes numpy arrays alone: use backend='torch' for tensors.")
    if partial and backend not in DRAW_PARTS:
        raise F4xError(f"The {backend} raster backend knows no depth limits or rows: use {', '.join(DRAW_PARTS)}.")
    reason = why_not(backend)
    if reason is not None:
        raise F4xError(f"The {backend} raster backend cannot run here ({reason}): use backend='torch'.")
    return backend


def why_not(backend: str) -> str | None:
    """Return why one of `BACKENDS` cannot run here; None when it can."""
    if backend == "gsplat":
        return _why_not_gsplat()
    if backend != "native":
        return None
    native = _native()
    if native is None:
        return "it is not part of this installation"
    return None if native.available() else str(native.why_not())


def _why_not_gsplat() -> str | None:
    if not find_spec("gsplat"):  # asked first: it does not take importing torch
        return "the package gsplat is not installed"
    import torch

    return None if torch.cuda.is_available() else "there is no CUDA device"


@cache
def _native() -> Any:
    """Return the native room, or None where it was left out of the installation."""
    return import_module(".native", __name__) if find_spec(f"{__name__}.native") else None


def as_tensors(inputs: RasterInput) -> RasterInput:
    """Return numpy `inputs` as torch tensors; the camera's matrices, which are float64, take the dtype of the Gaussians."""
    import torch

    def tensor(array: Array | None, dtype: Any) -> Any:
        return None if array is None else torch.from_numpy(np.require(array, dtype, ["C", "W"]))

    same, dtype = {"viewmat", "K"}, inputs.splats.means.dtype
    named = {name: tensor(array, dtype if name in same else None) for name, array in inputs.arrays().items()}
    return inputs.with_arrays(named)


def _through_numpy(function: Callable[[RasterInput], RasterOutput], inputs: RasterInput) -> RasterOutput:
    import torch

    with torch.no_grad():
        out = function(as_tensors(inputs))
    return RasterOutput(*(getattr(out, name).numpy() for name in ("channels", "depth", "alpha", "visible")))
