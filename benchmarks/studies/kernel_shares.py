"""Each compiled kernel's share of the multiply-add peak and of the copy rate, all measured in turn on one thread.

Operations and bytes are the least that the formulas need: no exponent is counted as more than its polynomial, no value is
read or written twice. A kernel at 100 % of either could not be faster on this machine.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from f4x_core.fit.losses import rgb_loss
from f4x_core.gaussians import appearance
from f4x_core.geometry import quaternion
from f4x_core.native import measure_peak, open_library
from f4x_core.native.kernels import Kernels
from f4x_core.raster import RasterConfig, RasterInput
from f4x_core.raster.native import library as raster
from f4x_core.scaffold.deformation.native import library as deformation

from ..speed.raster import (
    BACKWARD_CHANNEL_OPERATIONS,
    BACKWARD_OPERATIONS,
    FORWARD_CHANNEL_OPERATIONS,
    FORWARD_OPERATIONS,
    GRADIENTS,
    count_pairs,
    make_wavy_scene,
    view_of,
)
from ..study import Context, Figure, Findings, MissingError, Row, Table, time_columns
from ..timing import time_in_turn
from .physical_limit import COPY_BYTES

SIZES = (6000, 192, 108, 20_000), (50_000, 480, 270, 200_000)
"""Gaussians drawn, pixels, and Gaussians moved and coloured; of a quick and of a full report."""
PEAK_S = 0.05
"""Of multiply-adds in each round."""
FLOAT = 4
"""Bytes."""
SPLAT_FLOATS = 11
"""Mean, rotation, scale and opacity of a Gaussian."""
SLOT_BLEND, SLOT_SKIN, PLACE, DECODE = 24, 22, 66, 100
"""Operations of the deformation: of a neighbour its sign and share of the sum, its weight; of a Gaussian its own pose in the
world, and a motion from the blend with its application."""
DIRECTION, DIRECTION_BACKWARD = 42, 90
"""Of a colour: the direction of view in the Gaussian's own frame; and its gradient."""
HARMONIC, HARMONIC_BACKWARD = 3 + 6, 3 + 6 + 11
"""Of a coefficient: its basis function and three products; and back, with the derivative by the direction."""
SSIM_FORWARD, SSIM_BACKWARD = 4 * 2 * 11 * 2 + 24, 3 * 2 * 11 * 2 + 15
"""Of a pixel's channel: four blurred maps (11 taps across and down) and the formula; three blurred gradients."""


@dataclass(frozen=True)
class Kernel:
    """One call and the least that it has to do."""

    name: str
    size: str
    call: Callable[[], object]
    operations: float
    bytes: float


def measure_kernels(context: Context) -> Findings:
    """Time every kernel beside the machine's peaks in the same rounds."""
    if open_library()[0] is None or raster.open_library()[0] is None:
        raise MissingError(f"no compiled kernels ({raster.open_library()[1]}); `f4x doctor` says what they need.")
    count, width, height, many = context.choose(*SIZES)
    channels = context.choose((3, 35), (3, 35, 128, 512))
    groups: dict[str, Callable[[], Iterable[Kernel]]] = {
        "raster": partial(_raster_kernels, count, width, height, channels, context.seed),
        "deformation": partial(_deformation_kernels, many, context.seed),
        "colours": partial(_colour_kernels, many, context.seed),
        "similarity": partial(_similarity_kernels, width, height, context.seed),
    }
    rows: list[Row] = []
    for name, make in groups.items():
        rows += context.step(name, partial(_shares, make, context.repeats), size=(count, width, height, many))
    note = (
        "Operations and bytes: the least that the formulas need. Peaks: independent multiply-adds and a copy of"
        f" {COPY_BYTES >> 20} MB, timed between the kernels. `share of the limit`: the larger share, which is what bounds the"
        " kernel. Data that fit a cache can be read faster than the copy, so a small scene's share of it may be more than 100 %."
        " Results of more than 32 MB get fresh memory from the system at every call, which is counted: it is most of the time of"
        " the colours' backward pass at degree 3."
    )
    table = Table("kernels", rows, "One thread", (*time_columns(), OF_PEAK, OF_COPY, OF_LIMIT), note)
    figures = [
        Figure("Kernels under both limits", "kernels", OF_COPY, OF_PEAK, "kernel"),
        Figure("Operations and time", "kernels", "operations (M)", "time (ms)", "kernel", *time_columns()[1:]),
    ]
    return Findings([table], figures, _words(rows))


OF_PEAK, OF_COPY, OF_LIMIT = "share of multiply-adds", "share of copy", "share of the limit"


def _shares(make: Callable[[], Iterable[Kernel]], repeats: int) -> list[Row]:
    """Rows of kernels that are timed in turn with both peaks."""
    kernels = list(make())
    library, _ = open_library()
    assert library is not None
    rates: list[float] = []
    source, target = np.ones((2, COPY_BYTES // 8))

    def multiply_adds() -> None:
        rates.append(measure_peak(library, PEAK_S))

    calls: list[Callable[[], object]] = [kernel.call for kernel in kernels]
    calls += [partial(np.copyto, target, source), multiply_adds]
    *seconds, copies, _ = time_in_turn(calls, repeats)
    peak, rate = statistics.median(rates), 2 * COPY_BYTES / statistics.median(copies)
    rows = []
    for kernel, times in zip(kernels, seconds, strict=True):
        low, middle, high = statistics.quantiles(times, n=4, method="inclusive")
        fractions = kernel.operations / middle / peak, kernel.bytes / middle / rate
        row: Row = {"kernel": kernel.name, "size": kernel.size}
        row |= {"operations (M)": kernel.operations / 1e6, "bytes (MB)": kernel.bytes / 1e6}
        row |= dict(zip(time_columns(), (1e3 * middle, 1e3 * low, 1e3 * high), strict=True))
        rows.append(row | {OF_PEAK: fractions[0], OF_COPY: fractions[1], OF_LIMIT: max(fractions)})
    return rows


def _raster_kernels(count: int, width: int, height: int, channels: Sequence[int], seed: int) -> Iterable[Kernel]:
    """Forward and backward by channels."""
    library, _ = raster.open_library()
    assert library is not None
    for c in channels:
        scene = make_wavy_scene(count, c, width, height, seed)
        pairs = count_pairs(scene)
        arrays = {name: scene[name].numpy() for name in (*GRADIENTS, "K")}
        inputs = RasterInput(*view_of(scene | arrays), config=RasterConfig(threads=1))
        render = raster.forward(library, inputs, keep=True)
        sent = np.ones((height, width, c), np.float32)
        scene_bytes, image_bytes = FLOAT * count * (SPLAT_FLOATS + c), FLOAT * width * height * (c + 2)
        size = f"{count:,} Gaussians, {width} x {height}, {c} channels"
        yield Kernel(
            "raster forward",
            size,
            partial(raster.forward, library, inputs, keep=False),
            pairs * (FORWARD_OPERATIONS + FORWARD_CHANNEL_OPERATIONS * c),
            scene_bytes + image_bytes,
        )
        yield Kernel(
            "raster backward",
            size,
            partial(raster.backward, library, render, sent, None, None),
            pairs * (BACKWARD_OPERATIONS + BACKWARD_CHANNEL_OPERATIONS * c),
            2 * scene_bytes + image_bytes,
        )


def _deformation_kernels(count: int, seed: int, pairs: int = 1000, slots: int = 8) -> Iterable[Kernel]:
    """Time a frame's poses, and a step of the fit forward and backward."""
    rng = np.random.default_rng(seed)

    def turns(*shape: int) -> np.ndarray:
        turn = np.concatenate([np.ones((*shape, 1)), 0.3 * rng.normal(size=(*shape, 3))], -1)
        return quaternion.normalize(turn).astype(np.float32)

    table = np.concatenate([turns(pairs), 0.1 * rng.normal(size=(pairs, 4)).astype(np.float32)], 1)
    index = rng.integers(0, pairs, (count, slots)).astype(np.int32)
    weights = rng.dirichlet(np.ones(slots), count).astype(np.float32)
    means = rng.normal(size=(count, 3)).astype(np.float32)
    strength = np.ones(count, np.float32)
    nodes = np.concatenate([rng.normal(size=(pairs, 3)), np.ones((pairs, 1)), turns(pairs)], 1).astype(np.float32)
    arrays = {
        "xyz": means,
        "quat": turns(count),
        "index": index,
        "motions": table[None],
        "nodes": nodes,
        "mask": np.ones((count, slots), bool),
        "dw": np.zeros((count, slots), np.float32),
    }
    pose_bytes = FLOAT * count * 7
    size = f"{count:,} Gaussians, {slots} of {pairs} neighbours"
    yield Kernel(
        "poses of a frame",
        size,
        partial(deformation.move_gaussians, table, index, weights, strength, means, arrays["quat"]),
        count * (slots * SLOT_BLEND + DECODE),
        2 * pose_bytes + 2 * FLOAT * count * slots + table.nbytes,
    )
    once = count * (slots * (SLOT_BLEND + SLOT_SKIN) + PLACE + DECODE)
    moved = 2 * pose_bytes + count * slots * (2 * FLOAT + 1) + 2 * table.nbytes
    sent = [rng.normal(size=(1, count, n)).astype(np.float32) for n in (3, 4)]
    yield Kernel("deformation forward", size, partial(deformation.forward, arrays), once, moved)
    yield Kernel(
        "deformation backward",
        size,
        partial(deformation.backward, arrays, "sigma", 1, *sent),
        2 * once,  # a product has two factors, each with a gradient
        moved + pose_bytes + FLOAT * count * slots + 2 * table.nbytes,
    )


def _colour_kernels(count: int, seed: int) -> Iterable[Kernel]:
    """Colours of harmonics by degree."""
    generator = torch.Generator().manual_seed(seed)
    means, quats = (torch.randn(count, n, generator=generator).requires_grad_() for n in (3, 4))
    centre = torch.tensor([0.0, 0.0, -3.0])
    for degree in (1, 3):
        coefficients = (degree + 1) ** 2
        sh = torch.randn(count, coefficients, 3, generator=generator).requires_grad_()
        colors = appearance(sh, means, quats, centre, Kernels(native=True))
        sent = torch.ones_like(colors)
        read = FLOAT * count * (3 * coefficients + 7)
        size = f"{count:,} Gaussians, degree {degree}"
        yield Kernel(
            "colours forward",
            size,
            partial(appearance, sh, means, quats, centre, Kernels(native=True)),
            count * (DIRECTION + HARMONIC * coefficients),
            read + FLOAT * 3 * count,
        )
        yield Kernel(
            "colours backward",
            size,
            partial(torch.autograd.grad, colors, [sh, means, quats], sent, retain_graph=True),
            count * (DIRECTION + DIRECTION_BACKWARD + HARMONIC_BACKWARD * coefficients),
            2 * read + FLOAT * 3 * count,
        )


def _similarity_kernels(width: int, height: int, seed: int) -> Iterable[Kernel]:
    """Time the picture loss with its gradient, most of which is SSIM."""
    generator = torch.Generator().manual_seed(seed)
    image, target = torch.rand(2, height, width, 3, generator=generator)
    weight = torch.ones(height, width)

    def loss(**options: Any) -> torch.Tensor:
        return rgb_loss(image.requires_grad_(options["gradient"]), target, weight, 0.2, Kernels(native=True))

    values = 3 * width * height
    size = f"{width} x {height}, 3 channels"
    yield Kernel(
        "SSIM and L1", size, partial(loss, gradient=False), values * SSIM_FORWARD, FLOAT * (2 * values + width * height)
    )
    yield Kernel(
        "SSIM and L1, with gradient",
        size,
        partial(loss, gradient=True),
        values * (SSIM_FORWARD + SSIM_BACKWARD),
        FLOAT * (3 * values + width * height),
    )


def _words(rows: Sequence[Row]) -> list[str]:
    best, worst = (choose(rows, key=lambda row: row[OF_LIMIT]) for choose in (max, min))
    raster_rows = [row for row in rows if row["kernel"].startswith("raster")]
    low, high = (choose(row[OF_PEAK] for row in raster_rows) for choose in (min, max))
    return [
        f"Nearest to its limit is {best['kernel']} ({best['size']}) at {best[OF_LIMIT]:.0%}, farthest from it {worst['kernel']}"
        f" ({worst['size']}) at {worst[OF_LIMIT]:.1%}.",
        f"The rasteriser does {low:.1%} to {high:.1%} of the multiply-adds that one thread could do; comparisons, selections and"
        " lanes outside a splat are not counted as work.",
    ]
