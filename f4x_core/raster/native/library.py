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
from ...native import open_library as open_unchecked
from ...native.binder import FLOAT, INT32, INT64, POINTER, Array, Function, Result, Struct
from ..contract import NotFiniteError, RasterConfig, RasterInput, RasterOutput

SELF_CHECK = Path(__file__).with_name("self_check.npz")
# The largest relative error (L2) against the stored float64 values at which the library is still trusted: float32
# rounding gives 1e-6, the mildest real fault (a splat or a gradient term missing) gives more than 1e-2.
SELF_CHECK_ERROR = 1e-4

NOT_FINITE = 2
"""`failed` of f4x_forward for Gaussians that are not finite."""

_ROWS, _IMAGE = ("rows", "width"), ("rows", "width", "channels")
_GAUSSIANS = {
    "means": ("count", 3),
    "quats": ("count", 4),
    "scales": ("count", 3),
    "opacities": ("count",),
    "colors": ("count", "channels"),
}
PROBLEM = Struct(
    "Problem",
    {
        "count": INT64,
        **dict.fromkeys(("channels", "attached", "width", "height", "threads", "first_row", "last_row"), INT32),
        **dict.fromkeys(("near", "blur", "alpha_min", "alpha_max", "transmittance_min"), FLOAT),
        "intrinsics": FLOAT * 9,
        "viewmat": FLOAT * 16,
        **{name: Array("float32", shape) for name, shape in _GAUSSIANS.items()},
        "background": Array("float32", ("channels",), optional=True),
        "mean2d_offset": Array("float32", ("count", 2), optional=True),
        "limit": Array("float32", _ROWS, optional=True),
    },
    sizes=("rows",),
)
"""`struct Problem` of raster.cpp."""
GRADIENTS = Struct(
    "Gradients",
    {
        "d_channels": Array("float32", _IMAGE, optional=True),
        "d_depth": Array("float32", _ROWS, optional=True),
        "d_alpha": Array("float32", _ROWS, optional=True),
        **{"d_" + name: Array("float32", shape, output=True) for name, shape in _GAUSSIANS.items()},
        "d_viewmat": Array("float32", (4, 4), output=True),
        "d_mean2d_offset": Array("float32", ("count", 2), output=True),
    },
    sizes=("count", "channels", "rows", "width"),
)
"""`struct Gradients` of raster.cpp, where the names are without `d_`."""
F4X_FORWARD = Function(
    "f4x_forward",
    {
        "problem": PROBLEM,
        "keep": INT32,
        "channels": Array("float32", _IMAGE, output=True),
        "depth": Array("float32", _ROWS, output=True),
        "alpha": Array("float32", _ROWS, output=True),
        "visible": Array("bool", ("count",), output=True),
        "failed": Result(INT32),
    },
    POINTER,
)
F4X_BACKWARD = Function("f4x_backward", {"state": POINTER, "problem": PROBLEM, "gradients": GRADIENTS}, INT32)
F4X_COUNT_PAIRS = Function("f4x_count_pairs", {"state": POINTER, "problem": PROBLEM}, INT64)
F4X_RELEASE = Function("f4x_release", {"state": POINTER})


class _State:
    """Memory of one forward pass that the backward pass needs; freed when dropped."""

    def __init__(self, library: ctypes.CDLL, pointer: int):
        # Declared now: when the interpreter ends, little but the function itself may be left.
        self._release, self.pointer = F4X_RELEASE.declared(library), pointer

    def __del__(self):
        self._release(self.pointer)


@dataclass(frozen=True)
class Render:
    """A forward pass and, where it was kept, what its backward pass needs."""

    output: RasterOutput
    inputs: dict[str, Any]
    """Arrays as the kernel reads them, float32 and C-contiguous; None where one was left out."""
    problem: Any
    """`PROBLEM`, points into `inputs`."""
    state: _State | None


def open_library() -> tuple[ctypes.CDLL | None, str]:
    """Return the library after its self-check, or None and the reason why there is none; checked once per process."""
    library, reason = open_unchecked()
    return (None, reason) if library is None else _checked(library)


@lru_cache
def _checked(library: ctypes.CDLL) -> tuple[ctypes.CDLL | None, str]:
    difference = self_check(library)
    if not difference < SELF_CHECK_ERROR:
        return None, f"the library disagrees with the float64 reference by {difference:.1e} in its self-check"
    return library, ""


def self_check(library: ctypes.CDLL) -> float:
    """Return the largest relative L2 error of image and gradients against the stored float64 values of a small scene."""
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
        NotFiniteError: a Gaussian has a NaN or infinity among its values.
    """
    # The kernel walks bare pointers: a strided view must become a plain copy first.
    held: dict[str, Any] = {
        name: None if a is None else np.ascontiguousarray(a, np.float32) for name, a in inputs.arrays().items()
    }
    config, width, height = inputs.config, inputs.camera.width, inputs.camera.height
    first, last = inputs.drawn_rows.start, inputs.drawn_rows.stop
    count, channels = held["colors"].shape
    sizes = {"count": count, "channels": channels, "rows": last - first, "width": width}
    problem = PROBLEM(
        **sizes,
        attached=inputs.attached_channels,
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
        **{name: held.get(name) for name in PROBLEM.arrays},
    )
    image = np.empty((last - first, width, channels), np.float32)
    depth, alpha = np.empty(image.shape[:2], np.float32), np.empty(image.shape[:2], np.float32)
    visible, failed = np.empty(count, bool), INT32()
    pointer = F4X_FORWARD(problem, keep, image, depth, alpha, visible, failed, library=library, sizes=sizes)
    if failed.value == NOT_FINITE:
        raise NotFiniteError
    _check(failed.value, problem)
    return Render(RasterOutput(image, depth, alpha, visible), held, problem, _State(library, pointer) if keep else None)


def backward(
    library: ctypes.CDLL,
    render: Render,
    channels: np.ndarray | None,
    depth: np.ndarray | None,
    alpha: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """Return the gradients of means, quats, scales, opacities, colors, viewmat (4, 4) and mean2d_offset (N, 2) of a kept render.

    Args:
        library: the one that rendered.
        render: kept forward pass.
        channels: (H, W, C) gradient of the image; none = zeros, here and below.
        depth: (H, W) gradient of the depth.
        alpha: (H, W) gradient of the alpha.

    Raises:
        F4xError: memory ran out.
    """
    sent = GRADIENTS.plain(
        {"d_channels": channels, "d_depth": depth, "d_alpha": alpha}, "d_channels", "d_depth", "d_alpha"
    )
    rows, width, image_channels = render.output.channels.shape
    count = render.problem.count
    got = {name: np.empty_like(render.inputs[name]) for name in (*_GAUSSIANS, "viewmat")}
    got["mean2d_offset"] = np.empty((count, 2), np.float32)
    assert render.state is not None
    gradients = GRADIENTS(
        count=count,
        channels=image_channels,
        rows=rows,
        width=width,
        **sent,
        **{"d_" + name: array for name, array in got.items()},
    )
    _check(F4X_BACKWARD(render.state.pointer, render.problem, gradients, library=library), render.problem)
    return got


def count_pairs(library: ctypes.CDLL, render: Render) -> int:
    """Return (pixel, Gaussian) pairs that contributed to a kept render."""
    assert render.state is not None
    return F4X_COUNT_PAIRS(render.state.pointer, render.problem, library=library)


def _check(failed: int, problem: Any) -> None:
    if failed:
        raise F4xError(
            f"The native raster ran out of memory at {problem.count} Gaussians with {problem.channels} channels in "
            f"{problem.width} x {problem.last_row - problem.first_row} pixels: use fewer channels or a smaller image."
        )
