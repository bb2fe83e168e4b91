"""The `reference` backend: the compositing rule written out plainly, in float64, differentiable by plain autograd."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..geometry.camera import Camera
from ..geometry.quaternion import to_matrix
from ..geometry.splats import Splats
from .contract import RasterConfig, RasterInput, RasterOutput


def rasterize_reference(inputs: RasterInput) -> RasterOutput:
    """Composite Gaussians, tensors only; see `rasterize`. In float64, and slow: every splat meets every pixel."""
    doubled = {name: None if array is None else array.double() for name, array in inputs.arrays().items()}
    inputs = inputs.with_arrays(doubled)
    config, drawn, limit, colors = inputs.config, inputs.drawn_rows, inputs.limit, inputs.colors
    means, opacities, camera = inputs.splats.means, inputs.splats.opacities, inputs.camera
    viewmat, width, height = camera.world_to_camera, camera.width, camera.height
    mean2d, covariance, z = project_ewa(inputs.splats, camera, config)
    if inputs.mean2d_offset is not None:
        mean2d = mean2d + inputs.mean2d_offset

    # alpha >= alpha_min inside the ellipse d^T cov^-1 d <= reach, whose box has half sizes sqrt(reach cov_ii).
    in_front = means @ viewmat[2, :3] + viewmat[2, 3] > config.near
    reach = 2 * torch.log(opacities.detach() / config.alpha_min).clamp_min(0)
    half = (reach[:, None] * covariance.detach().diagonal(dim1=1, dim2=2)).sqrt()  # (N, 2)
    last = torch.tensor([width - 0.5, height - 0.5], dtype=torch.float64, device=means.device)
    meets = ((mean2d + half >= 0.5) & (mean2d - half <= last)).all(1)
    visible = in_front & meets & (opacities >= config.alpha_min)

    order = visible.nonzero()[:, 0]
    order = order[torch.argsort(z[order], stable=True)]  # front to back, ties by index
    conic = torch.linalg.inv(covariance[order])
    mean2d, opacities = mean2d[order], opacities[order]
    features = torch.cat((torch.ones_like(z)[:, None], z[:, None], colors), 1)[order]
    detached = 2 + inputs.attached_channels

    def composite_row(row: int, mean2d: Tensor, conic: Tensor, opacities: Tensor, features: Tensor) -> Tensor:
        seen = None if limit is None else features[:, 1] < limit[row - drawn.start, :, None]
        weight = weigh_row(pixel_row(row, width).to(mean2d.device), mean2d, conic, opacities, config, seen)
        return torch.cat((weight @ features[:, :detached], weight.detach() @ features[:, detached:]), 1)  # (W, 2 + C)

    # Checkpointed by row: autograd keeps no (pixels x N) matrices.
    image = torch.stack(
        [
            checkpoint(composite_row, row, mean2d, conic, opacities, features, use_reentrant=False)
            for row in range(drawn.start, drawn.stop)
        ]
    )
    alpha, depth, channels = image[..., 0], image[..., 1], image[..., 2:]
    if inputs.background is not None:
        light = (1 - alpha)[..., None].expand(channels.shape)
        light = torch.cat((light[..., : detached - 2], light[..., detached - 2 :].detach()), -1)
        channels = channels + light * inputs.background
    return RasterOutput(channels, depth, alpha, visible)


def pixel_row(row: int, width: int) -> Tensor:
    """Return (W, 2) float64 pixel centres of a row of an image."""
    x = torch.arange(width, dtype=torch.float64) + 0.5
    return torch.stack((x, torch.full_like(x, row + 0.5)), -1)


def weigh_row(
    pixel: Tensor,
    mean2d: Tensor,
    conic: Tensor,
    opacities: Tensor,
    config: RasterConfig,
    seen: Tensor | None = None,
) -> Tensor:
    """Return the blending weights (W, N) of N splats in the pixels of a row by the rules of 3DGS; 0 where one adds nothing.

    Args:
        pixel: (W, 2) centres of the pixels, px, float64.
        mean2d: (N, 2) px, float64; splats are sorted front to back.
        conic: (N, 2, 2) inverse covariances, 1/px^2, float64.
        opacities: (N,) in [0, 1], float64.
        config: its cut and clamp of alpha and its stop.
        seen: (W, N) bool, False where a splat is hidden from a pixel; None = all are seen.
    """
    d = pixel[:, None] - mean2d  # (W, N, 2)
    alpha = opacities * torch.exp(-0.5 * torch.einsum("wni,nij,wnj->wn", d, conic, d))
    alpha = torch.where(alpha < config.alpha_min, 0.0, alpha.clamp_max(config.alpha_max))
    if seen is not None:
        alpha = torch.where(seen, alpha, 0.0)
    light_after = torch.cumprod(1 - alpha, 1)
    light_before = torch.cat((torch.ones_like(pixel[:, :1]), light_after[:, :-1]), 1)
    return torch.where(light_after > config.transmittance_min, alpha * light_before, 0.0)


def project_ewa(splats: Splats, camera: Camera, config: RasterConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Project by EWA (Zwicker et al. 2001, as in 3DGS); return mean2d (N, 2) px, covariance (N, 2, 2) px^2 and z (N,).

    Splats not in front of the near plane come out with z = 1: finite, and meant to be culled.
    """
    means, viewmat, K, width, height = (
        splats.means,
        camera.world_to_camera,
        camera.intrinsics,
        camera.width,
        camera.height,
    )
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).unbind(1)
    z = torch.where(z > config.near, z, 1.0)
    mean2d = torch.stack((fx * x / z + cx, fy * y / z + cy), 1)

    # J is linearised at most 30 % of the half image outside the frustum; safe for off-centre principal points (gsplat).
    margin_x, margin_y = 0.3 * 0.5 * width / fx, 0.3 * 0.5 * height / fy
    x = z * (x / z).clamp(-cx / fx - margin_x, (width - cx) / fx + margin_x)
    y = z * (y / z).clamp(-cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack((fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2), 1).view(-1, 2, 3)
    M = J @ viewmat[:3, :3] @ to_matrix(splats.quats) @ torch.diag_embed(splats.scales)
    blur = config.blur * torch.eye(2, dtype=means.dtype, device=means.device)
    return mean2d, M @ M.transpose(1, 2) + blur, z
