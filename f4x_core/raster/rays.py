"""Gaussians composited along rays, as path tracers draw them: Cycles of Blender 5.3 is what this follows.

A rasterizer of splats projects each Gaussian as a whole and sorts by centres. A path tracer meets it on the ray of a pixel: with
`o_g = S^-1 R^T (o - mu)` and `d_g = S^-1 R^T d` (3D Gaussian Ray Tracing, Moenne-Loccoz et al. 2024, eq. 8) the response is
largest at `t = -o_g.d_g / d_g.d_g`, where it is `exp(-|o_g x d_g|^2 / 2 d_g.d_g)`. That is the alpha, and `t` the order, pixel by
pixel. Nothing is added to the size of a Gaussian, but the filter of the pixels blurs the picture: here each Gaussian is as much
wider as the filter is wide at its depth, and its opacity falls so that its light stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import F4xError
from ..geometry.camera import Camera
from ..geometry.quaternion import to_matrix
from ..geometry.splats import Splats
from ..native.rays import F4X_RAYS, F4X_RAYS_BACKWARD, RAYS
from .contract import RasterConfig

CYCLES_FILTER = 0.1726
"""Variance in px^2, along each axis, of Cycles' default pixel filter (Blackman-Harris of 1.5 pixels)."""
BLACKMAN_HARRIS = (0.35875, -0.48829, 0.14128, -0.01168)
"""Coefficients of the cosines of the Blackman-Harris filter."""
FILTER_WIDTH = 3
"""Pixels across which that filter reaches."""
NARROW = 0.3
"""Standard deviation in finer pixels of what is drawn there before the filter of the whole pixels: enough against aliasing."""
BOX_MARGIN = 1.2
"""Factor by which boxes are larger than projected ellipses, which are approximations."""


@dataclass(frozen=True)
class RayConfig:
    """Constants of Cycles (`intern/cycles/kernel/geom/gsplat_intersect.h` and `scene/pointcloud.cpp` of Blender 5.3)."""

    near: float = RasterConfig.near
    """Clip start of the camera, world units along its axis."""
    filter: float = CYCLES_FILTER
    """Variance of the pixel filter in px^2."""
    alpha_min: float = 1 / 512
    """A Gaussian contributes to a pixel only where its alpha is at least this; Cycles has no such cut."""
    faintest: float = 0.01
    """Gaussians of less opacity are not drawn; the ball outside of which one is cut off touches where alpha falls to this."""
    min_aspect: float = 1e-3
    """Scales are taken to be at least this times the largest of the three."""
    threads: int = field(default_factory=lambda: RasterConfig().threads)
    """Worker threads; never changes the result."""


@dataclass(frozen=True)
class Projected:
    """N Gaussians in the axes of a camera, ready to be met by rays."""

    means: Tensor
    """(N,3)"""
    whiten: Tensor
    """(N,3,3) S^-1 R^T: offsets from the centre in standard deviations."""
    opacities: Tensor
    """(N,)"""
    radii: Tensor
    """(N,) of the ball outside of which a Gaussian is cut off."""
    boxes: Tensor
    """(N,4) left, top, right, bottom in pixels of what may be seen."""


def project(splats: Splats, camera: Camera, config: RayConfig) -> Projected:
    """Put Gaussians (tensors) into the axes of `camera` and add the pixel filter; differentiable in all but radii and boxes."""
    dtype = splats.means.dtype
    view = torch.tensor(camera.world_to_camera, dtype=dtype)
    k = torch.tensor(camera.intrinsics, dtype=dtype)
    means = splats.means @ view[:3, :3].T + view[:3, 3]
    axes = view[:3, :3] @ to_matrix(splats.quats)
    z = torch.where(means[:, 2] > config.near, means[:, 2], 1.0)
    scales = torch.maximum(splats.scales, config.min_aspect * splats.scales.amax(1, keepdim=True))
    wide = torch.sqrt(scales**2 + config.filter * (z / camera.focal)[:, None] ** 2)
    zero = torch.zeros_like(z)
    to_x = torch.stack((k[0, 0] / z, zero, -k[0, 0] * means[:, 0] / z**2), 1)
    to_y = torch.stack((zero, k[1, 1] / z, -k[1, 1] * means[:, 1] / z**2), 1)
    across, down = (torch.einsum("nj,njk->nk", row, axes) for row in (to_x, to_y))
    area, wide_area = (torch.linalg.cross(across * s, down * s).norm(dim=1) for s in (scales, wide))
    seen = splats.opacities >= config.faintest
    opacities = torch.where(seen, splats.opacities * area / wide_area, 0.0)
    with torch.no_grad():
        beyond = (splats.opacities / config.faintest).clamp_min(1).log().mul(2).sqrt()
        radii = beyond * splats.scales.amax(1)
        reach = (opacities / config.alpha_min).clamp_min(1).log().mul(2).sqrt() * BOX_MARGIN
        half = torch.stack([(row * wide).norm(dim=1) * reach for row in (across, down)], 1)
        ball = radii / z * camera.focal * BOX_MARGIN
        half = torch.minimum(half, ball[:, None].expand(-1, 2)) + 1
        half[radii > z / 2] = max(camera.width, camera.height) * 2.0  # no ellipse any more
        center = means[:, :2] / z[:, None] * torch.stack((k[0, 0], k[1, 1])) + k[:2, 2]
        boxes = torch.cat((center - half, center + half), 1)
    return Projected(means, (axes / wide[:, None, :]).transpose(1, 2), opacities, radii, boxes)


def rasterize_rays(splats: Splats, colors: Tensor, camera: Camera, config: RayConfig | None = None) -> Tensor:
    """Composite N Gaussians along rays: (H,W,4) colours and alpha in float32 on the CPU, by the compiled library.

    Differentiable once, in scales, rotations, opacities and colours; centres stay.

    Args:
        splats: tensors, float32.
        colors: (N,3) in the light in which they are to be blended.
        camera: a pinhole camera.
        config: Cycles' constants by default.

    Raises:
        F4xError: memory ran out.
    """
    config = config or RayConfig()
    seen = project(splats, camera, config)
    k = camera.intrinsics
    fixed = dict(
        **dict(count=len(seen.means), width=camera.width, height=camera.height, threads=config.threads),
        **dict(fx=k[0, 0], fy=k[1, 1], cx=k[0, 2], cy=k[1, 2], near_plane=config.near, alpha_min=config.alpha_min),
        **dict(means=seen.means.detach().contiguous(), radii=seen.radii.contiguous(), boxes=seen.boxes.contiguous()),
    )
    image: Tensor = _Rays.apply(fixed, seen.whiten, seen.opacities, colors)
    return image


def filtered_rays(
    splats: Splats, colors: Tensor, camera: Camera, oversample: int = 1, config: RayConfig | None = None
) -> Tensor:
    """Composite Gaussians along `oversample`^2 rays for each pixel and weigh them by Cycles' pixel filter: (H,W,4).

    One ray for each pixel takes the filter as wider Gaussians, which is right for each of them alone but not where several
    meet within a pixel: 33 dB to Cycles, 39 with several rays (a fitted scene of 30,000 Gaussians). See `rasterize_rays`.
    """
    if oversample == 1:
        return rasterize_rays(splats, colors, camera, config)
    fine = replace(config or RayConfig(), filter=NARROW**2)
    image = rasterize_rays(splats, colors, _oversampled(camera, oversample), fine)
    weights = filter_weights(oversample)
    rows = image.permute(2, 0, 1)[:, None]  # (4,1,H',W')
    rows = torch.nn.functional.conv2d(rows, weights[None, None, None, :], stride=(1, oversample))
    return torch.nn.functional.conv2d(rows, weights[None, None, :, None], stride=(oversample, 1))[:, 0].permute(1, 2, 0)


def filter_weights(oversample: int) -> Tensor:
    """Return the weights (3 oversample,), sum 1, of Cycles' pixel filter along one axis, for rays through finer pixels."""
    place = (torch.arange(FILTER_WIDTH * oversample) + 0.5) / (FILTER_WIDTH * oversample)
    waves = torch.cos(2 * torch.pi * torch.arange(4)[:, None] * place)
    weights = torch.tensor(BLACKMAN_HARRIS) @ waves
    return weights / weights.sum()


def _oversampled(camera: Camera, oversample: int) -> Camera:
    """Return the camera with finer pixels, and one whole pixel more on every side, which the filter reaches into."""
    intrinsics = np.array(camera.intrinsics, np.float64)
    intrinsics[:2, 2] += 1
    intrinsics[:2] *= oversample
    width, height = (oversample * (side + FILTER_WIDTH - 1) for side in (camera.width, camera.height))
    return replace(camera, intrinsics=intrinsics, width=width, height=height)


class _Rays(torch.autograd.Function):
    @staticmethod
    def forward(ctx, fixed: dict[str, Any], whiten: Tensor, opacities: Tensor, colors: Tensor) -> Tensor:
        """Return the image (H,W,4); `fixed` are the fields of the library's problem that have no gradient."""
        own = {"whiten": whiten, "opacities": opacities, "colors": colors}
        ctx.fields = fixed | {name: tensor.detach().contiguous() for name, tensor in own.items()}
        image = torch.empty(fixed["height"], fixed["width"], 4)
        _run(F4X_RAYS, image=image, **ctx.fields)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        fields = ctx.fields
        slopes = {f"d_{name}": torch.empty_like(fields[name]) for name in ("whiten", "opacities", "colors")}
        _run(F4X_RAYS_BACKWARD, d_image=gradient.contiguous(), **fields, **slopes)
        return None, *slopes.values()


def _run(function: Any, **fields: Any) -> None:
    if function(RAYS(**fields)):
        raise F4xError(
            f"Drawing {fields['count']:,} Gaussians along rays ran out of memory at {fields['width']} x {fields['height']} pixels:"
            " use a smaller --width."
        )
