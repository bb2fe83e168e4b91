"""Decides mid-fit, on frames that the regression has not seen, whether one more degree of spherical harmonics pays.

Before a fit the evidence is weak: colours along tracks change with the sampling of fine textures more than with any shine. So a
fit begins with plain colours. In its middle, the residual of each frame is attributed to the Gaussians by their blend weights,
and a regression over view directions predicts it, on the middle frames of the path, from the next band of harmonics. If that
explains the frames at both ends of the path as well, the band is added with the coefficients that were found: small learning
rates would not bring it that far in a short fit. Tested on every other frame instead, fine textures are predicted as well as
shine is (0.4 to 0.7 dB on toy walls that do not shine); at the ends of the path shine alone is (-0.4 dB there, 0.14 to 1.6 dB
where the wall shines).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry import quaternion, spherical_harmonics
from ..geometry.arrays import evenly_spaced
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..raster import RasterConfig, rasterize
from ..raster.blend_weights import blend_weight_sums
from .model import SceneModel

GAIN_DB = 0.1
"""Gain of PSNR on the judging frames from which the next degree is added."""
FRAMES = 16
"""Frames sampled; the first and the last quarter of them only judge. They cost less than 2 % of the shortest fit."""
SPREAD = 0.2
"""Prior standard deviation of a coefficient. With the noise of the frames it sets the ridge: a steep slope that was seen over a
few degrees only would look like fog from the side."""
MIN_WEIGHT_SUM = 1e-3
"""Pixels; keeps the regression of a Gaussian that no frame sees from dividing by zero."""


MIN_NOISE = 1e-6
"""Mean square; pictures have 8 bits."""


class Band(NamedTuple):
    """Coefficients and gain of one more degree of the harmonics."""

    gain: float
    """PSNR (dB) on left-out frames, against what a change of the plain colours alone brings."""
    plain: Tensor
    """(N,1,3) change of the first coefficient."""
    more: Tensor
    """(N,2*degree+1,3) coefficients of the new band."""


class _View(NamedTuple):
    """One frame."""

    splats: Splats
    camera: Camera
    residual: Tensor
    """(H,W,3) frame minus render."""
    terms: Tensor
    """(N,1+n) the constant and the new band, at each Gaussian's direction in its own frame."""


def next_band(model: SceneModel, images: Tensor, config: RasterConfig, backend: str) -> Band:
    """Regress the residuals of `images (F,H,W,3)` uint8 on the harmonics of the next degree; exact but for overlaps.

    A pixel's residual is that of all Gaussians that are blended there, so each Gaussian's is the mean over its pixels by its blend
    weights (`raster.blend_weights`), and the normal equations are small: a constant and the band, by Gaussian, ridge on the
    band. N counts all Gaussians drawn, in the order of `SceneModel.posed`.
    """
    chosen = evenly_spaced(len(images), FRAMES).tolist()
    end = max(len(chosen) // 4, 1)
    left_out = chosen[:end] + chosen[-end:]
    with torch.no_grad():
        views = _views(model, images, chosen[end:-end], config, backend)
        first = next(views)
        size = first.terms.shape[1]
        normal = torch.zeros(len(first.terms), size, size)
        wanted = torch.zeros(len(first.terms), size, 3)
        left = []
        for each in (first, *views):
            sums = _weight_sums(each, config, backend)  # (N,4): of the rest, and of everything
            sums /= sums[:, 3:].clamp_min(1)  # a frame is one observation, however many pixels: they err alike
            weighted = each.terms * sums[:, 3:]
            normal += weighted[:, :, None] * each.terms[:, None]
            wanted += each.terms[:, :, None] * sums[:, None, :3]
            left.append(each.residual.square().sum())
        constant = wanted[:, 0] / (normal[:, 0, :1] + MIN_WEIGHT_SUM)
        noise = torch.stack(left).sum() / (len(left) * first.residual.numel())
        ridge = torch.full((size,), max(float(noise), MIN_NOISE) / SPREAD**2)
        ridge[0] = MIN_WEIGHT_SUM
        found = torch.linalg.solve(normal + torch.diag(ridge), wanted)  # (N,1+n,3)
        before, after = 0.0, 0.0
        for each in _views(model, images, left_out, config, backend):
            explained = torch.cat([constant, (each.terms[:, :, None] * found).sum(1)], 1)
            out = rasterize(each.splats, explained, each.camera, config=config, backend=backend).channels
            before += float((each.residual - out[..., :3]).square().mean())
            after += float((each.residual - out[..., 3:]).square().mean())
    gain = 10 * float(np.log10(max(before, 1e-12) / max(after, 1e-12)))
    return Band(gain, found[:, :1] / spherical_harmonics.C0, found[:, 1:])


def _views(model: SceneModel, images: Tensor, frames: list[int], config: RasterConfig, backend: str) -> Iterator[_View]:
    """Yield the model's view of each of `frames`, one after the other."""
    height, width = images.shape[1:3]
    for frame in frames:
        moved = None if model.dynamic is None else model.dynamic_at(float(model.times[frame]))[0]
        splats, camera = model.posed(moved), model.rig.camera(frame, width, height)
        out = model.render(splats, camera, config=config, backend=backend)
        residual = images[frame].float() / 255 - out.channels[..., :3].clamp(0, 1)
        own = quaternion.rotate(quaternion.conjugate(quaternion.normalize(splats.quats)), splats.means - camera.center)
        degree = spherical_harmonics.degree_of(splats.sh.shape[1]) + 1
        band = spherical_harmonics.basis(own, degree)[:, splats.sh.shape[1] :]
        yield _View(splats, camera, residual, torch.cat([torch.ones(len(band), 1), band], 1))


def _weight_sums(view: _View, config: RasterConfig, backend: str) -> Tensor:
    """Return (N,4) each Gaussian's blend weights, summed over the residual's three colours and over all pixels."""
    layers = torch.cat([view.residual, torch.ones_like(view.residual[..., :1])], -1).numpy()
    splats, camera = view.splats.map(Tensor.numpy), view.camera
    fixed = Camera(camera.intrinsics.numpy(), camera.world_to_camera.numpy(), camera.width, camera.height)
    return torch.from_numpy(blend_weight_sums(splats, fixed, layers, config=config, backend=backend))
