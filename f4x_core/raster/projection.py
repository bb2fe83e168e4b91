"""EWA projection of 3D Gaussians to image ellipses, in few fused torch operations with plain autograd."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.splats import Splats
from .contract import FRUSTUM_MARGIN, RasterConfig

# Opacities below it are culled anyway; it keeps the logarithm and its gradient finite at opacity 0.
OPACITY_FLOOR = 1e-6


class Ellipses(NamedTuple):
    """N projected Gaussians, component-major so that every row is one contiguous vector.

    The exponent is kept in the factored form q = A (dx - k dy)^2 + r dy^2 with A = cov_yy / det, k = cov_xy / cov_yy,
    r = 1 / cov_yy: needles keep their precision far from their centre, where A dx^2 + 2B dx dy + C dy^2 cancels.
    """

    table: Tensor
    """(6, N) mean x, mean y (pixels), A, k, r, log2 opacity; carries gradients."""
    depth: Tensor
    """(N,) camera z; 1 where the splat is culled; carries gradients."""
    half_box: Tensor
    """(2, N) half width and height in pixels of the box around {alpha >= alpha_min}, detached."""
    visible: Tensor
    """(N,) bool: in front of the near plane, and the box meets the image."""


def project(splats: Splats, camera: Camera, config: RasterConfig, mean2d_offset: Tensor | None = None) -> Ellipses:
    """Project Gaussians (shapes as in `rasterize`) to image ellipses.

    The off-centre-safe frustum clamp of x/z, y/z in J is gsplat's (`gsplat/cuda/_torch_impl.py`); the covariance is
    M M^T + blur I with M = J R_cw R(q) diag(s), so that det = |m_0 x m_1|^2 + blur tr + blur^2 never cancels.
    """
    means, quats, scales, opacities = splats.means, splats.quats, splats.scales, splats.opacities
    viewmat, K, width, height = camera.world_to_camera, camera.intrinsics, camera.width, camera.height
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    rotation = viewmat[:3, :3]
    x, y, z = torch.addmm(viewmat[:3, 3:], rotation, means.t())
    in_front = z.detach() > config.near
    z = torch.where(in_front, z, 1.0)
    inverse_z = z.reciprocal()
    u, v = x * inverse_z, y * inverse_z
    mean2d = torch.stack((u * fx + cx, v * fy + cy))  # (2, N)
    if mean2d_offset is not None:
        mean2d = mean2d + mean2d_offset.t()

    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * width / fx, FRUSTUM_MARGIN * 0.5 * height / fy
    u = u.clamp(-cx / fx - margin_x, (width - cx) / fx + margin_x)
    v = v.clamp(-cy / fy - margin_y, (height - cy) / fy + margin_y)
    J = torch.stack((rotation[0, :, None] - rotation[2, :, None] * u, rotation[1, :, None] - rotation[2, :, None] * v))
    J = J * (torch.stack((fx, fy))[:, None] * inverse_z)[:, None]  # (2, 3, N) = J R_cw
    M = (J[:, :, None] * _rotation(quats.t())).sum(1) * scales.t()  # (2, 3, N)

    var_x, var_y = M.square().sum(1)
    cov = (M[0] * M[1]).sum(0)
    (ax, ay, az), (bx, by, bz) = M
    minors = (ay * bz - az * by).square() + (az * bx - ax * bz).square() + (ax * by - ay * bx).square()
    det = minors + config.blur * (var_x + var_y) + config.blur**2
    var_x, var_y = var_x + config.blur, var_y + config.blur
    log_opacity = opacities.clamp_min(OPACITY_FLOOR).log2()
    table = torch.stack((*mean2d, var_y / det, cov / var_y, var_y.reciprocal(), log_opacity))

    with torch.no_grad():
        reach = cut(log_opacity, config.alpha_min)
        half_box = (torch.stack((var_x, var_y)) * reach).sqrt()
        size = mean2d.new_tensor((width, height))[:, None]
        # Pixel centres run from 0.5 to size - 0.5.
        inside = ((mean2d + half_box >= 0.5) & (mean2d - half_box <= size - 0.5)).all(0)
        visible = inside & in_front & (opacities >= config.alpha_min)
    return Ellipses(table, z, half_box, visible)


def cut(log_opacity: Tensor, alpha_min: float) -> Tensor:
    """Return the largest exponent q at which alpha = 2^log_opacity exp(-q / 2) still reaches `alpha_min`, at least 0."""
    return (2 * math.log(2) * (log_opacity - math.log2(alpha_min))).clamp_min(0)


def _rotation(quats: Tensor) -> Tensor:
    """Return R(q) (3, 3, N) of quats (4, N) wxyz of any length; a zero quaternion counts as the identity.

    The component-major twin of `geometry.quaternion.to_matrix`: contiguous rows are several times faster here.
    """
    w, x, y, z = quats
    s = 2 / (w * w + x * x + y * y + z * z).clamp_min(1e-24)
    sx, sy, sz = s * x, s * y, s * z
    wx, wy, wz = w * sx, w * sy, w * sz
    xx, xy, xz = x * sx, x * sy, x * sz
    yy, yz, zz = y * sy, y * sz, z * sz
    entries = (1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy)
    return torch.stack(entries).view(3, 3, -1)
