"""The compiled raster behind numpy arrays: self-check, forward and backward. No torch here."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import F4xError
from ...geometry.camera import Camera
from ...geometry.splats import Splats
from ...native import address
from ...native import open_library as open_unchecked
from ..contract import RasterConfig, RasterInput, RasterOutput

SELF_CHECK = Path(__file__).with_name("self_check.npz")
# The largest relative error (L2) against the stored float64 values at which the library is still trusted: float32
# rounding gives 1e-6, the mildest real fault (a splat or a gradient term missing) gives more than 1e-2.
SELF_CHECK_ERROR = 1e-4

_POINTER = ctypes.c_void_p


class _Problem(ctypes.Structure):
    """`struct Problem` of raster.cpp."""

    _fields_ = (
        [("count", ctypes.c_int64)]
        + [(name, ctypes.c_int32) for name in ("channels", "attached", "width", "height", "threads")]
        + [(name, ctypes.c_int32) for name in ("first_row", "last_row")]
        + [(name, ctypes.c_float) for name in ("near", "blur", "alpha_min", "alpha_max", "transmittance_min")]
        + [("intrinsics", ctypes.c_float * 9), ("viewmat", ctypes.c_float * 16)]
        + [(n, _POINTER) for n in ("means", "quats", "scales", "opacities", "colors")]
        + [(n, _POINTER) for n in ("background", "mean2d_offset", "limit")]
    )


class _Gradients(ctypes.Structure):
    """`struct Gradients` of raster.cpp."""

    _fields_ = [
        (n, _POINTER)
        for n in ("channels", "depth", "alpha", "means", "quats", "scales", "opacities", "colors", "viewmat", "offset")
    ]


class _State:
    """What the backward pass needs of one forward pass; hands its memory back when dropped."""

    def __init__(self, library: ctypes.CDLL, pointer: int):
        self._library, self.pointer = library, pointer

    def __del__(self):
        self._library.f4x_release(self.pointer)


@dataclass(frozen=True)
class Render:
    """A forward pass and, where it was kept, what its backward pass needs."""

    output: RasterOutput
    inputs: dict[str, Any]
    """Arrays as the kernel reads them, float32 and C-contiguous; None where one was left out."""
    problem: _Problem
    """Points into `inputs`."""
    state: _State | None


def open_library() -> tuple[ctypes.CDLL | None, str]:
    """The library after its self-check, or None and the reason why there is none; checked once per process."""
    library, reason = open_unchecked()
    return (None, reason) if library is None else _checked(library)


@lru_cache
def _checked(library: ctypes.CDLL) -> tuple[ctypes.CDLL | None, str]:
    library.f4x_forward.restype = _POINTER
    library.f4x_forward.argtypes = [
        ctypes.POINTER(_Problem),
        ctypes.c_int32,
        *[_POINTER] * 4,
        ctypes.POINTER(ctypes.c_int32),
    ]
    library.f4x_backward.argtypes = [_POINTER, ctypes.POINTER(_Problem), ctypes.POINTER(_Gradients)]
    library.f4x_count_pairs.argtypes = [_POINTER, ctypes.POINTER(_Problem)]
    library.f4x_count_pairs.restype = ctypes.c_int64
    library.f4x_release.argtypes = [_POINTER]
    library.f4x_release.restype = None
    difference = self_check(library)
    if not difference < SELF_CHECK_ERROR:
        return None, f"the library disagrees with the float64 reference by {difference:.1e} in its self-check"
    return library, ""


def self_check(library: ctypes.CDLL) -> float:
    """Largest relative L2 error of image and gradients against the stored float64 values of a small scene."""
    with np.load(SELF_CHECK) as file:
        stored = {name: file[name] for name in file.files}

    def group(kind: str) -> dict[str, np.ndarray]:
        return {name.removeprefix(kind): a for name, a in stored.items() if name.startswith(kind)}

    height, width = stored["expect_depth"].shape
    arrays: dict[str, Any] = group("input_")
    camera = Camera(arrays.pop("K"), arrays.pop("viewmat"), width, height)
    splats = Splats(*(arrays.pop(name) for name in ("means", "quats", "scales", "opacities")))
    colors = arrays.pop("colors")
    inputs = RasterInput(
        splats, colors, camera, **arrays, config=RasterConfig(threads=1), detached_from=int(stored["detached_from"])
    )
    render = forward(library, inputs, keep=True)
    got = {name: getattr(render.output, name) for name in ("channels", "depth", "alpha")}
    got |= backward(library, render, **group("sent_"))
    expected = group("expect_")
    return max(float(np.linalg.norm(got[name] - e) / np.linalg.norm(e)) for name, e in expected.items())


def forward(library: ctypes.CDLL, inputs: RasterInput, keep: bool) -> Render:
    """Draw numpy `inputs` of any dtype and strides; `keep` what the backward pass needs.

    Raises:
        F4xError: memory ran out.
    """
    # The kernel walks bare pointers: a strided view must become a plain copy first.
    held: dict[str, Any] = {
        name: None if a is None else np.ascontiguousarray(a, np.float32) for name, a in inputs.arrays().items()
    }
    config, width, height = inputs.config, inputs.camera.width, inputs.camera.height
    first, last = inputs.drawn_rows.start, inputs.drawn_rows.stop
    count, channels = held["colors"].shape
    problem = _Problem(
        count=count,
        channels=channels,
        attached=inputs.attached_channels,
        width=width,
        height=height,
        threads=max(1, config.threads),
        first_row=first,
        last_row=last,
        near=config.near,
        blur=config.blur,
        alpha_min=config.alpha_min,
        alpha_max=config.alpha_max,
        transmittance_min=config.transmittance_min,
        intrinsics=tuple(held["K"].ravel()),
        viewmat=tuple(held["viewmat"].ravel()),
        **{
            n: address(held.get(n))
            for n in ("means", "quats", "scales", "opacities", "colors", "background", "mean2d_offset", "limit")
        },
    )
    image = np.empty((last - first, width, channels), np.float32)
    depth, alpha = np.empty(image.shape[:2], np.float32), np.empty(image.shape[:2], np.float32)
    visible = np.empty(count, bool)
    failed = ctypes.c_int32()
    pointer = library.f4x_forward(
        problem, keep, address(image), address(depth), address(alpha), address(visible), failed
    )
    _check(failed.value, problem)
    return Render(RasterOutput(image, depth, alpha, visible), held, problem, _State(library, pointer) if keep else None)


def backward(
    library: ctypes.CDLL,
    render: Render,
    channels: np.ndarray | None,
    depth: np.ndarray | None,
    alpha: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """Gradients of means, quats, scales, opacities, colors, viewmat (4, 4) and mean2d_offset (N, 2) of a kept render.

    Args:
        library: the one that rendered.
        render: kept forward pass.
        channels: (H, W, C) gradient of the image; none = zeros, here and below.
        depth: (H, W) gradient of the depth.
        alpha: (H, W) gradient of the alpha.

    Raises:
        F4xError: memory ran out.
    """
    sent = [None if a is None else np.ascontiguousarray(a, np.float32) for a in (channels, depth, alpha)]
    n = render.problem.count
    got = {
        name: np.empty_like(render.inputs[name])
        for name in ("means", "quats", "scales", "opacities", "colors", "viewmat")
    }
    got["mean2d_offset"] = np.empty((n, 2), np.float32)
    assert render.state is not None
    gradients = _Gradients(*map(address, [*sent, *got.values()]))
    _check(library.f4x_backward(render.state.pointer, render.problem, gradients), render.problem)
    return got


def count_pairs(library: ctypes.CDLL, render: Render) -> int:
    """(pixel, Gaussian) pairs that contributed to a kept render."""
    assert render.state is not None
    return library.f4x_count_pairs(render.state.pointer, render.problem)


def _check(failed: int, problem: _Problem) -> None:
    if failed:
        raise F4xError(
            f"The native raster ran out of memory at {problem.count} Gaussians with {problem.channels} channels in "
            f"{problem.width} x {problem.last_row - problem.first_row} pixels: use fewer channels or a smaller image."
        )
