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
from ..raster import RasterConfig, rasterize
from ..raster.light import light_into
from .model import Posed, SceneModel

GAIN_DB = 0.1
"""PSNR on left-out frames that the next degree must bring."""
FRAMES = 16
"""That are looked at, the first and the last quarter left out: that costs less than 2 % of the shortest fit."""
SPREAD = 0.2
"""Standard deviation of a coefficient that is to be expected: with the noise in the pictures it says how far to trust what was
seen from a few degrees, which is fog from elsewhere when it is taken for a slope."""
LEAST_LIGHT = 1e-3
"""Pixels; keeps the regression of a Gaussian that no frame sees from dividing by zero."""


LEAST_NOISE = 1e-6
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

    posed: Posed
    view: Tensor
    intrinsics: Tensor
    rest: Tensor
    """(H,W,3) picture minus drawn."""
    terms: Tensor
    """(N,1+n) the constant and the new band, at each Gaussian's direction in its own frame."""


def next_band(model: SceneModel, pictures: Tensor, config: RasterConfig, backend: str) -> Band:
    """Regress what `pictures (F,H,W,3)` uint8 differ by on the harmonics of the next degree; exact but for overlaps.

    A pixel's rest is that of all Gaussians whose light it is, so each Gaussian's is the light-weighted mean over its pixels
    (`raster.light`), and the normal equations are small: a constant and the band, by Gaussian, ridge on the band. N counts
    all Gaussians drawn, in the order of `SceneModel.posed`.
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
            light = _light(each, config, backend)  # (N,4): of the rest, and of everything
            light /= light[:, 3:].clamp_min(1)  # a frame is one observation, however many pixels: they err alike
            weighted = each.terms * light[:, 3:]
            normal += weighted[:, :, None] * each.terms[:, None]
            wanted += each.terms[:, :, None] * light[:, None, :3]
            left.append(each.rest.square().sum())
        constant = wanted[:, 0] / (normal[:, 0, :1] + LEAST_LIGHT)
        noise = torch.stack(left).sum() / (len(left) * first.rest.numel())
        ridge = torch.full((size,), max(float(noise), LEAST_NOISE) / SPREAD**2)
        ridge[0] = LEAST_LIGHT
        found = torch.linalg.solve(normal + torch.diag(ridge), wanted)  # (N,1+n,3)
        before, after = 0.0, 0.0
        for each in _look(model, pictures, left_out, config, backend):
            explained = torch.cat([constant, (each.terms[:, :, None] * found).sum(1)], 1)
            shapes = each.posed.means, each.posed.quats, each.posed.scales, each.posed.opacities
            height, width = each.rest.shape[:2]
            lens = each.view, each.intrinsics, width, height
            out = rasterize(*shapes, explained, *lens, config=config, backend=backend).channels
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
        posed = model.posed(moved)
        view, intrinsics = model.rig.view(frame), model.rig.intrinsics(frame, width, height)
        out = model.render(posed, view, intrinsics, width, height, config=config, backend=backend)
        rest = pictures[frame].float() / 255 - out.channels[..., :3].clamp(0, 1)
        centre = -(view[:3, :3].T @ view[:3, 3])
        own = quaternion.rotate(quaternion.conjugate(quaternion.normalize(posed.quats)), posed.means - centre)
        degree = spherical_harmonics.degree_of(posed.sh.shape[1]) + 1
        band = spherical_harmonics.basis(own, degree)[:, posed.sh.shape[1] :]
        yield _Seen(posed, view, intrinsics, rest, torch.cat([torch.ones(len(band), 1), band], 1))


def _light(seen: _Seen, config: RasterConfig, backend: str) -> Tensor:
    """(N,4) each Gaussian's light into the rest's three colours and into all pixels."""
    layers = torch.cat([seen.rest, torch.ones_like(seen.rest[..., :1])], -1).numpy()
    posed = seen.posed
    means, quats, scales, opacities = (
        part.numpy() for part in (posed.means, posed.quats, posed.scales, posed.opacities)
    )
    camera = seen.view.numpy(), seen.intrinsics.numpy()
    return torch.from_numpy(
        light_into(means, quats, scales, opacities, *camera, layers, config=config, backend=backend)
    )
