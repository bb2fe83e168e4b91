"""Whether colours must change with the direction of view: asked of the pictures, when a fit has explained what it can without.

Evidence from before the fit says little: colours along tracks change with the sampling of fine textures more than with any
shine. So a fit begins with plain colours. In its middle, what the pictures differ by is spread over the Gaussians that sent
the light, and in the middle of the path a regression over the directions predicts it from the next band of harmonics. If that
explains the two ends of the path too, the band is added, and begins where the regression ended: small learning rates would not
come that far in a short fit. From every other frame to those between, fine textures are predicted as well as shine (0.4 to 0.7
dB on toy walls that do not shine); to the ends of the path shine alone is (-0.4 there, 0.14 to 1.6 dB where the wall shines).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry import quaternion, spherical_harmonics
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..raster import RasterConfig, rasterize
from ..raster.blend_weights import blend_weight_sums
from .model import SceneModel

GAIN_DB = 0.1
"""PSNR on left-out frames that the next degree must bring."""
FRAMES = 16
"""That are looked at, the first and the last quarter left out: that costs less than 2 % of the shortest fit."""
SPREAD = 0.2
"""Standard deviation of a coefficient that is to be expected: with the noise in the pictures it says how far to trust what was
seen from a few degrees, which is fog from elsewhere when it is taken for a slope."""
MIN_WEIGHT_SUM = 1e-3
"""Pixels; keeps the regression of a Gaussian that no frame sees from dividing by zero."""


MIN_NOISE = 1e-6
"""Mean square; pictures have 8 bits."""


class Band(NamedTuple):
    """What one more degree would bring."""

    gain: float
    """PSNR (dB) on left-out frames, against what a change of the plain colours alone brings."""
    plain: Tensor
    """(N,1,3) change of the first coefficient."""
    more: Tensor
    """(N,2*degree+1,3) coefficients of the new band."""


class _Seen(NamedTuple):
    """One frame."""

    splats: Splats
    camera: Camera
    rest: Tensor
    """(H,W,3) picture minus drawn."""
    terms: Tensor
    """(N,1+n) the constant and the new band, at each Gaussian's direction in its own frame."""


def next_band(model: SceneModel, pictures: Tensor, config: RasterConfig, backend: str) -> Band:
    """Regress what `pictures (F,H,W,3)` uint8 differ by on the harmonics of the next degree; exact but for overlaps.

    A pixel's rest is that of all Gaussians that are blended there, so each Gaussian's is the mean over its pixels by its blend
    weights (`raster.blend_weights`), and the normal equations are small: a constant and the band, by Gaussian, ridge on the
    band. N counts all Gaussians drawn, in the order of `SceneModel.posed`.
    """
    count = len(pictures)
    chosen = sorted({round(i * (count - 1) / (FRAMES - 1)) for i in range(FRAMES)})
    end = max(len(chosen) // 4, 1)
    left_out = chosen[:end] + chosen[-end:]
    with torch.no_grad():
        seen = _look(model, pictures, chosen[end:-end], config, backend)
        first = next(seen)
        size = first.terms.shape[1]
        normal = torch.zeros(len(first.terms), size, size)
        wanted = torch.zeros(len(first.terms), size, 3)
        left = []
        for each in (first, *seen):
            sums = _weight_sums(each, config, backend)  # (N,4): of the rest, and of everything
            sums /= sums[:, 3:].clamp_min(1)  # a frame is one observation, however many pixels: they err alike
            weighted = each.terms * sums[:, 3:]
            normal += weighted[:, :, None] * each.terms[:, None]
            wanted += each.terms[:, :, None] * sums[:, None, :3]
            left.append(each.rest.square().sum())
        constant = wanted[:, 0] / (normal[:, 0, :1] + MIN_WEIGHT_SUM)
        noise = torch.stack(left).sum() / (len(left) * first.rest.numel())
        ridge = torch.full((size,), max(float(noise), MIN_NOISE) / SPREAD**2)
        ridge[0] = MIN_WEIGHT_SUM
        found = torch.linalg.solve(normal + torch.diag(ridge), wanted)  # (N,1+n,3)
        before, after = 0.0, 0.0
        for each in _look(model, pictures, left_out, config, backend):
            explained = torch.cat([constant, (each.terms[:, :, None] * found).sum(1)], 1)
            out = rasterize(each.splats, explained, each.camera, config=config, backend=backend).channels
            before += float((each.rest - out[..., :3]).square().mean())
            after += float((each.rest - out[..., 3:]).square().mean())
    gain = 10 * float(np.log10(max(before, 1e-12) / max(after, 1e-12)))
    return Band(gain, found[:, :1] / spherical_harmonics.C0, found[:, 1:])


def _look(
    model: SceneModel, pictures: Tensor, frames: list[int], config: RasterConfig, backend: str
) -> Iterator[_Seen]:
    """What there is to know of each of `frames`."""
    height, width = pictures.shape[1:3]
    for frame in frames:
        moved = None if model.dynamic is None else model.dynamic_at(float(model.times[frame]))[0]
        splats, camera = model.posed(moved), model.rig.camera(frame, width, height)
        out = model.render(splats, camera, config=config, backend=backend)
        rest = pictures[frame].float() / 255 - out.channels[..., :3].clamp(0, 1)
        own = quaternion.rotate(quaternion.conjugate(quaternion.normalize(splats.quats)), splats.means - camera.center)
        degree = spherical_harmonics.degree_of(splats.sh.shape[1]) + 1
        band = spherical_harmonics.basis(own, degree)[:, splats.sh.shape[1] :]
        yield _Seen(splats, camera, rest, torch.cat([torch.ones(len(band), 1), band], 1))


def _weight_sums(seen: _Seen, config: RasterConfig, backend: str) -> Tensor:
    """(N,4) each Gaussian's blend weights, summed over the rest's three colours and over all pixels."""
    layers = torch.cat([seen.rest, torch.ones_like(seen.rest[..., :1])], -1).numpy()
    splats, camera = seen.splats.map(Tensor.numpy), seen.camera
    view = Camera(camera.intrinsics.numpy(), camera.world_to_camera.numpy(), camera.width, camera.height)
    return torch.from_numpy(blend_weight_sums(splats, view, layers, config=config, backend=backend))
