"""Draws a case's Gaussians by every backend of the rasteriser in float32 and compares with the reference in float64."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch

from benchmarks.speed.raster import draw, make_wavy_scene
from benchmarks.studies.hard_cases import Check, within
from f4x_core.raster import why_not

WIDTH, HEIGHT, GAUSSIANS, CHANNELS = 45, 31, 80, 3
GRADIENTS = ("means", "quats", "scales", "opacities", "colors", "viewmat")
WORST_PIXEL = 1.1 / 255
"""One pixel in a thousand may differ by one splat at the alpha cut, where rounding decides."""
Drawing = dict[str, Any]
"""Keyword arguments of `rasterize`."""


def wavy(count: int = GAUSSIANS, width: int = WIDTH, height: int = HEIGHT) -> Drawing:
    """An ordinary scene to be made hard."""
    return make_wavy_scene(count, CHANNELS, width, height)


def backends() -> list[str]:
    """Those that run here and take gradients, fastest first."""
    return [name for name in ("native", "torch") if why_not(name) is None]


def differentiate(drawing: Drawing, backend: str, **options: Any) -> tuple[Any, dict[str, torch.Tensor]]:
    """The picture, and the gradients of a fixed random functional of it."""
    drawing = {k: v.detach().clone() if isinstance(v, torch.Tensor) else v for k, v in drawing.items()}
    leaves = {name: drawing[name].requires_grad_() for name in GRADIENTS}
    out = draw(**drawing, backend=backend, **options)
    generator = torch.Generator().manual_seed(3)
    images = (out.channels, out.depth, out.alpha)
    sum((image * torch.rand(image.shape, generator=generator).to(image)).sum() for image in images).backward()
    return out, {name: leaf.grad for name, leaf in leaves.items()}


def compare(drawing: Drawing, picture: float = 2e-5, gradient: float = 1e-4, **options: Any) -> Iterator[Check]:
    """Picture and gradients of every backend, and the picture of numpy alone, against the reference."""
    true, true_gradients = differentiate(drawing, "reference", **options)
    for backend in backends():
        out, gradients = differentiate(drawing, backend, **options)
        yield from _pictures(out, true, picture, backend)
        errors = {name: _relative(gradients[name], expected, gradient) for name, expected in true_gradients.items()}
        worst = max(errors, key=lambda name: errors[name])
        yield within(f"gradients, of {worst} the worst", errors[worst], gradient, backend)
    arrays = {k: v.detach().numpy() if isinstance(v, torch.Tensor) else v for k, v in drawing.items()}
    yield from _pictures(draw(**arrays, backend="plain", **options), true, picture, "plain")


def _pictures(out: Any, true: Any, allowed: float, backend: str) -> Iterator[Check]:
    """Colours, depth and alpha together, each relative to its largest value where that is above 1."""
    errors = []
    for name in ("channels", "depth", "alpha"):
        expected = getattr(true, name).detach()
        got = torch.as_tensor(getattr(out, name)).detach().double()
        scale = expected.abs().max().clamp_min(1) if expected.numel() else 1.0
        errors.append(((got - expected).abs() / scale).flatten())
    error = torch.nan_to_num(torch.cat(errors), nan=float("inf"))
    yield within("picture, 999 of 1000 pixels", error.quantile(0.999), allowed, backend)
    yield within("picture, its worst pixel", error.max(), WORST_PIXEL, backend)


def _relative(got: torch.Tensor, expected: torch.Tensor, allowed: float) -> float:
    """L2 error relative to the truth; a gradient that is 0 in truth may be 1e-9."""
    if not got.isfinite().all():
        return float("inf")
    return float((got.double() - expected).norm() / (expected.norm() + 1e-9 / allowed))
