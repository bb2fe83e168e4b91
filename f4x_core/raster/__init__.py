"""Rasteriser: composites any number of channels of 3D Gaussians front to back, with gradients."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from .contract import RasterConfig, RasterOutput
from .inputs import Arguments, check_shapes, leave_out_broken, make_floating

if TYPE_CHECKING:
    from .contract import Array

__all__ = ["BACKENDS", "CPU_BACKENDS", "RasterConfig", "RasterOutput", "choose_backend", "rasterize", "why_not"]

CPU_BACKENDS = ("native", "torch", "reference")
"""What renders tensors on the CPU, which all of `f4x` has."""
BACKENDS = (*CPU_BACKENDS, "gsplat")
"""What renders with gradients. `plain` besides is numpy alone and draws pictures only."""
DRAW_PARTS = ("native", "reference", "plain")


def rasterize(
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
    backend: str = "auto",
    detached_from: int | None = None,
    mean2d_offset: Array | None = None,
    limit: Array | None = None,
    rows: slice | None = None,
) -> RasterOutput:
    """Composite N Gaussians into a `height` x `width` image of C channels (EWA splatting, 3DGS rules).

    Args:
        means: (N, 3) centres, world frame, world units.
        quats: (N, 4) rotations wxyz, need not be normalised.
        scales: (N, 3) standard deviations along the own axes (activated), world units.
        opacities: (N,) in [0, 1] (activated).
        colors: (N, C) any channels: rgb, latent features, ...
        viewmat: (4, 4) world_to_camera, OpenCV axes.
        K: (3, 3) intrinsics in pixels; pixel (col, row) is looked through at (col + 0.5, row + 0.5).
        width: image width in pixels.
        height: image height in pixels.
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

    Tensors (any dtype, one device; whole numbers count as float32) give tensors with gradients to means, quats, scales,
    opacities, colors, viewmat, background and mean2d_offset; numpy arrays give numpy arrays, without gradients.
    `reference` answers in float64 always.

    A Gaussian with a NaN or infinity among its values is left out and counted in `dropped`.

    Raises:
        F4xError: shapes that do not fit, a camera that is not finite, an unknown backend, one that is not installed or that
            cannot do what is asked for; with `config.debug` also Gaussians that are not finite.
    """
    arguments: Arguments = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "colors": colors,
        "viewmat": viewmat,
        "K": K,
        "background": background,
        "mean2d_offset": mean2d_offset,
    }
    if limit is not None:
        arguments["limit"] = limit
    partial = limit is not None or rows is not None
    config = config or RasterConfig()
    check_shapes(arguments, width, height, detached_from, rows)
    arguments, dropped = leave_out_broken(make_floating(arguments), config.debug)
    options: dict[str, Any] = {"config": config, "detached_from": detached_from}
    if rows is not None:
        options["rows"] = rows
    chosen = choose_backend(backend, arguments["means"], partial=partial)
    function: Any  # their signatures differ in `limit` and `rows`
    if chosen == "native":
        from .native import rasterize_native as function
    elif chosen == "reference":
        from .reference import rasterize_reference as function
    elif chosen == "gsplat":
        from .gsplat import rasterize_gsplat as function
    elif chosen == "plain":
        from .plain import rasterize_plain as function
    else:
        from .tiles import rasterize_torch as function
    if chosen not in ("native", "plain") and isinstance(means, np.ndarray):
        out = _through_numpy(function, width, height, arguments, options)
    else:
        out = function(width=width, height=height, **arguments, **options)
    return replace(out, dropped=dropped) if dropped else out


def choose_backend(backend: str, means: Array | None = None, *, partial: bool = False) -> str:
    """Name of the backend that `backend` stands for, given the means to be drawn and whether there are limits or rows.

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
    """Why one of `BACKENDS` cannot run here; None when it can."""
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


def _native() -> Any:
    """The native room, or None where it was left out of the installation."""
    return import_module(".native", __name__) if find_spec(f"{__name__}.native") else None


def _through_numpy(function: Any, width: int, height: int, arguments: Arguments, options: Any) -> RasterOutput:
    import torch

    tensors = {
        k: None if v is None else torch.from_numpy(np.require(v, requirements=["C", "W"])) for k, v in arguments.items()
    }
    with torch.no_grad():
        out = function(width=width, height=height, **tensors, **options)
    return RasterOutput(*(getattr(out, name).numpy() for name in ("channels", "depth", "alpha", "visible")))
