"""The loss of one step as a list of terms: each has a name, a weight, and the steps at which it counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..raster import RasterOutput
from ..scaffold.losses import MotionTerms, motion_loss
from ..scaffold.motion_native import MotionWeights
from .config import FitConfig
from .frame_data import FrameTarget, MovingTracks
from .frame_native import FrameMaps
from .losses import FrameFactors, depth_loss, depth_roughness, frame_losses, rgb_loss
from .model import Present, SceneModel

TRACK_CLAMP = 20.0
"""A correspondence further off than this many pixels is an outlier whose pull is capped."""
MIN_ALPHA = 0.1
"""Lower bound of the alpha by which a rendered position is divided."""
MIN_DEPTH = 1e-2
"""World units; rendered positions nearer to the camera plane, or behind it, are projected from here."""


@dataclass(frozen=True)
class Rendered:
    """The model's render of one supervised frame, or of a window of it."""

    on: FrameTarget
    """The frame and its priors."""
    output: RasterOutput
    """Channels: rgb; where something moves the alpha of what is dynamic; with a partner, positions (3) at the partner's time."""
    partner: int | None = None
    """The supervised frame whose tracks it is compared with, if any."""
    step: int = 0
    """The step for which it was drawn."""
    offset: Tensor | None = None
    """(N,2) pixels by which the projected means were moved: zeros, whose gradient tells how the loss pulls at them."""
    present: Present | None = None
    """The dynamic Gaussians among the N; None where nothing moves."""

    @property
    def hidden(self) -> Tensor | None:
        """(H,W,1) bool: pixels of the frame that nobody saw; None where all were seen."""
        return None if self.on.hidden is None else self.on.hidden[..., None]

    @property
    def channels(self) -> Tensor:
        """(H,W,C) what was drawn; it sends no gradient where nobody saw the frame."""
        channels, hidden = self.output.channels, self.hidden
        return channels if hidden is None else torch.where(hidden, channels.detach(), channels)

    @property
    def rgb(self) -> Tensor:
        """(H,W,3)"""
        return self.channels[..., :3]

    @property
    def target(self) -> Tensor:
        """(H,W,3) uint8, the frame; what was drawn where nobody saw it, so that no window of SSIM differs for it."""
        frame, hidden = self.on.rgb, self.hidden
        if hidden is None:
            return frame
        return torch.where(hidden, (255 * self.rgb.detach().clamp(0, 1)).round().byte(), frame)

    @property
    def dynamic_alpha(self) -> Tensor:
        """(H,W) alpha of the dynamic Gaussians behind what hides them."""
        return self.channels[..., 3]

    @property
    def partner_positions(self) -> Tensor:
        """(H,W,3) composited world positions at the partner's time."""
        return self.output.channels[..., 4:7]

    @property
    def motion(self) -> Tensor:
        """(H,W) float32 moving score of the frame."""
        return self.on.priors.motion.float()


@dataclass(frozen=True)
class LossTerm:
    """One summand of the loss."""

    name: str
    weight: float
    value: Callable[[Rendered], Tensor]
    """The unweighted scalar."""
    every: int = 1
    """Steps between two at which it counts."""
    whole: bool = False
    """True if it is about whole frames or the cameras, and a window says nothing about it."""

    def due(self, step: int) -> bool:
        """Return True if it counts at `step`."""
        return step % self.every == 0


def total_loss(terms: Sequence[LossTerm], step: int, rendered: Rendered) -> Tensor:
    """Return the weighted sum of the terms that count at `step`."""
    total = torch.zeros(())
    for term in terms:
        if term.due(step):
            total = total + term.weight * term.value(rendered)
    return total


def loss_terms(model: SceneModel, tracks: MovingTracks, config: FitConfig) -> tuple[LossTerm, ...]:
    """Return the terms of a fit, those without weight left out."""
    weights = config.losses
    losses = _Losses(model, tracks, config)
    if model.kernels.native:
        terms = [LossTerm("pixels", 1.0, losses.pixels)]
    else:
        terms = [
            LossTerm("rgb", 1.0, losses.rgb),
            LossTerm("depth", weights.depth, losses.depth),
            LossTerm("roughness", config.rough_every * weights.roughness, losses.roughness, config.rough_every),
            LossTerm("mask", weights.mask if model.dynamic is not None else 0.0, losses.mask),
        ]
    if model.dynamic is not None:
        terms += [
            LossTerm("track", weights.track, losses.track, config.track_every, whole=True),
            LossTerm("motion", config.motion_every, losses.motion, config.motion_every),
        ]
    terms.append(LossTerm("camera smoothness", weights.camera_smoothness, losses.camera_smoothness, whole=True))
    return tuple(term for term in terms if term.weight)


@dataclass(frozen=True)
class _Losses:
    model: SceneModel
    tracks: MovingTracks
    config: FitConfig

    def pixels(self, rendered: Rendered) -> Tensor:
        """Return the weighted sum of the losses rgb, depth, roughness and mask, by the compiled library."""
        config, maps = self.config, rendered.on.priors
        weights, output = config.losses, rendered.output
        rough = config.rough_every * weights.roughness if rendered.step % config.rough_every == 0 else 0.0
        return frame_losses(
            (rendered.channels, output.depth, output.alpha),
            FrameMaps(rendered.target, maps.depth, maps.confidence, maps.motion),
            FrameFactors(weights.ssim, weights.moving, weights.depth, rough, weights.mask),
            self.model.kernels.threads,
        )

    def rgb(self, rendered: Rendered) -> Tensor:
        """L1 and SSIM against the frame; moving pixels weigh more, because moving objects are small but looked at."""
        weights = self.config.losses
        target = rendered.target.float() / 255
        attention = 1 + (weights.moving - 1) * rendered.motion  # (H,W)
        return rgb_loss(rendered.rgb, target, attention, weights.ssim)

    def depth(self, rendered: Rendered) -> Tensor:
        """Compare inverse depth with the prior's, by its confidence."""
        maps, output = rendered.on.priors, rendered.output
        return depth_loss(output.depth, output.alpha, maps.depth, maps.confidence.float())

    def roughness(self, rendered: Rendered) -> Tensor:
        """Bends of the background's depth where the frame is plain and the prior's depth unsure."""
        output = rendered.output
        unsure = (1 - rendered.on.priors.confidence.float()) * (1 - rendered.motion)
        return depth_roughness(output.depth, output.alpha, rendered.target.float() / 255, unsure)

    def mask(self, rendered: Rendered) -> Tensor:
        """Compare the alpha of the dynamic Gaussians with the moving mask, as far as the motion score is certain."""
        certain = (2 * rendered.motion - 1).abs()  # 0 where the score says nothing
        error = (rendered.dynamic_alpha - (rendered.motion > 0.5).float()).abs()
        return (error * certain).mean()

    def track(self, rendered: Rendered) -> Tensor:
        """Mean capped distance (pixels of the priors) between the tracks in the partner and what is rendered to move there."""
        partner, alpha = rendered.partner, rendered.output.alpha
        if partner is None:
            return alpha.new_zeros(())
        here, expected = self.tracks.shared(rendered.on.frame, partner)
        width, height = self.tracks.width, self.tracks.height
        grid = (
            here / torch.tensor([width, height], dtype=torch.float32) * 2 - 1
        )  # (n,2) in [-1,1], pixel edges at the ends
        maps = torch.cat([rendered.partner_positions, alpha[..., None]], -1).permute(2, 0, 1)[None]  # (1,4,H,W)
        sampled = torch.nn.functional.grid_sample(maps, grid[None, None], align_corners=False)[0, :, 0].T  # (n,4)
        x = sampled[:, :3] / sampled[:, 3:].clamp_min(MIN_ALPHA)
        camera = self.model.rig.camera(partner, width, height)
        view, intrinsics = camera.world_to_camera, camera.intrinsics
        local = x @ view[:3, :3].T + view[:3, 3]
        z = local[:, 2:].clamp_min(MIN_DEPTH)
        pixels = local[:, :2] / z * torch.stack([intrinsics[0, 0], intrinsics[1, 1]]) + intrinsics[:2, 2]
        return torch.linalg.vector_norm(pixels - expected, dim=1).clamp_max(TRACK_CLAMP).mean()

    def motion(self, rendered: Rendered) -> Tensor:
        """Return the physics-inspired losses of the nodes on the frames around the rendered one."""
        config, model, w = self.config, self.model, self.config.losses
        nodes, frame, reach = model.nodes, rendered.on.frame, max(config.shifts)
        assert nodes is not None
        window = slice(max(0, frame - reach), frame + reach + 1)
        weights = MotionWeights(
            w.arap_coordinate, w.arap_length, w.velocity, w.acceleration, w.rotation_velocity, w.rotation_acceleration
        )
        xyz, quat = (nodes.parameters[name][window] for name in ("node_xyz", "node_quat"))
        times = torch.from_numpy(model.times[window])
        shifts = dict(zip(config.shifts, config.shift_weights, strict=True))
        loss = motion_loss(xyz, quat, times, MotionTerms(nodes.edges, shifts, weights, model.kernels))
        if model.dynamic is not None and model.dynamic.use_dw:
            loss = loss + w.dw * model.dynamic.parameters["dw"].abs().mean()
        return loss

    def camera_smoothness(self, rendered: Rendered) -> Tensor:
        """Squared second differences of the corrections to the camera path, per pixel of image motion."""
        return self.model.rig.smoothness() * self.tracks.width
