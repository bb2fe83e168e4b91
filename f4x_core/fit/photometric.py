"""The joint photometric stage: all Gaussians, the scaffold and the cameras against the frames."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..clip import Clip
from ..errors import Cancelled
from ..gaussians import DensityControl, DynamicGaussians, SetOptimiser, StaticGaussians
from ..geometry.spherical_harmonics import degree_of
from ..priors import Priors
from ..progress import Progress, silent
from ..raster import RasterConfig
from ..scaffold.losses import arap_losses, smoothness_losses
from ..scaffold.optimise import with_graph
from .checkpoint import save_checkpoint
from .config import FitConfig, Rate
from .harmonics import GAIN_DB, next_band
from .losses import depth_loss, psnr, rgb_loss
from .model import NodeSet, SceneModel
from .node_control import add_nodes, drop_nodes

NODE_RATES = {"node_xyz": "node_xyz", "node_quat": "node_quat", "radius_logit": "radius"}
CAMERA_RATES = {"camera_rotation": "camera_rotation", "camera_position": "camera_position", "focal": "focal"}
SCAFFOLD_ARRAYS = ("xyz", "quat", "radius", "certain", "ids", "neighbours", "edge_mask")
# A correspondence further off than this many pixels is an outlier whose pull is capped.
TRACK_CLAMP = 20.0
# Frames rendered for one point of the quality curve.
MEASURED_FRAMES = 4
# Tracks that move less surely than this carry no track loss.
TRACK_MOTION = 0.5


@dataclass
class FrameData:
    """What supervises one resolution: tensors of F frames, H x W pixels."""

    rgb: Tensor
    """(F,H,W,3) uint8."""
    depth: Tensor
    """(F,H,W) float32, NaN = unknown."""
    confidence: Tensor
    """(F,H,W) float16."""
    motion: Tensor
    """(F,H,W) float16 moving score."""
    width: int
    height: int

    @classmethod
    def full(cls, clip: Clip, priors: Priors) -> FrameData:
        """The supervised frames at the fitted size."""
        rgb = torch.from_numpy(np.ascontiguousarray(clip.frames[priors.frames]))
        depth, confidence, motion = (
            torch.from_numpy(np.ascontiguousarray(a)) for a in (priors.depth, priors.depth_confidence, priors.motion)
        )
        return cls(rgb, depth, confidence, motion, priors.width, priors.height)

    def halved(self) -> FrameData:
        """Half the resolution: colours averaged over 2 x 2 pixels, the other maps sampled."""
        width, height = self.width // 2, self.height // 2
        crop = self.rgb[:, : 2 * height, : 2 * width].reshape(len(self.rgb), height, 2, width, 2, 3)
        rgb = torch.stack([frame.float().mean((1, 3)).round().byte() for frame in crop])
        depth, confidence, motion = (
            a[:, : 2 * height : 2, : 2 * width : 2].contiguous() for a in (self.depth, self.confidence, self.motion)
        )
        return FrameData(rgb, depth, confidence, motion, width, height)


class PhotometricStage:
    """The training loop as an object, so that it can be stopped at any step and continued bit-equal."""

    def __init__(self, model: SceneModel, clip: Clip, priors: Priors, config: FitConfig, next_id: int):
        """Set up optimisers, density control and data for `config.steps` steps."""
        self.model, self.config, self.next_id = model, config, next_id
        self.levels = [FrameData.full(clip, priors)]
        if config.coarse > 0:
            self.levels.append(self.levels[0].halved())
        self.tracks = (
            torch.from_numpy(priors.tracks) if priors.tracks is not None else torch.zeros(len(priors.frames), 0, 2)
        )
        visible = priors.tracks_visible if priors.tracks_visible is not None else np.zeros(self.tracks.shape[:2], bool)
        motion = priors.tracks_motion if priors.tracks_motion is not None else np.zeros(self.tracks.shape[1])
        self.tracks_visible = torch.from_numpy(visible & (motion > TRACK_MOTION)[None])
        self.generator = torch.Generator().manual_seed(config.seed)
        self.order: list[int] = []
        self.step = 0
        self.history: list[dict[str, float]] = []
        self.band_gains: list[float] = []
        """dB that each degree of the harmonics, one after the other, would bring views from elsewhere."""
        self.next_node_id = int(model.nodes.scaffold.ids.max()) + 1 if model.nodes is not None else 0
        self.spawned = {name: len(gaussians) for name, gaussians in self._sets()}
        """Gaussians of each set at the start."""
        self.raster = RasterConfig(threads=config.all_threads)
        self._start_optimisers()

    def _start_optimisers(self) -> None:
        config, model = self.config, self.model
        self.optimisers = {name: SetOptimiser(own, self._rates(name, 0.0)) for name, own in self._sets()}
        densities = {"static": config.density_static, "dynamic": config.density_dynamic}
        self.controls = {
            name: DensityControl(optimiser, densities[name], config.steps)
            for name, optimiser in self.optimisers.items()
        }
        groups = [{"params": [model.rig.parameters[n]], "lr": 0.0, "name": n} for n in CAMERA_RATES]
        if model.nodes is not None:
            groups += [{"params": [model.nodes.parameters[n]], "lr": 0.0, "name": n} for n in NODE_RATES]
        self.shared = torch.optim.Adam(groups, eps=1e-15)

    def run(self, checkpoint: Path | None = None, config_hash: str = "", progress: Progress = silent) -> None:
        """Train to the last step, writing `checkpoint` now and then; an interrupt leaves one behind."""
        total = self.config.steps
        message = ""
        whole = True  # inside a step there is nothing to continue from: then the last checkpoint stays
        try:
            while self.step < total:
                whole = False
                loss = self.train_step()
                self.step += 1
                if self.step % self.config.measure_every == 0 or self.step == total:
                    self.measure(loss)
                    message = f"{self.history[-1]['psnr']:.1f} dB, {self.count():,} Gaussians"
                whole = True
                if checkpoint is not None and self.step % self.config.checkpoint_every == 0:
                    save_checkpoint(checkpoint, self.state(config_hash))
                progress("photometric", self.step, total, message)
        except (KeyboardInterrupt, Cancelled):
            if checkpoint is not None and whole:
                save_checkpoint(checkpoint, self.state(config_hash))
            raise
        if checkpoint is not None:
            save_checkpoint(checkpoint, self.state(config_hash))

    def count(self) -> int:
        """Gaussians of both sets."""
        return len(self.model.static) + (len(self.model.dynamic) if self.model.dynamic is not None else 0)

    def train_step(self) -> float:
        """One frame: render, losses, gradients, optimisers, density control. Returns the loss."""
        config, model = self.config, self.model
        share = self.step / config.steps
        self._set_rates(share)
        self._update_graph(share)
        self._consider_harmonics()
        if not self.order:
            self.order = torch.randperm(len(model.times), generator=self.generator).tolist()
        frame = self.order.pop()
        data = self.levels[-1] if share < config.coarse else self.levels[0]
        background = torch.rand(3, generator=self.generator) if config.random_background else None
        loss, offset, visible = self._loss(frame, data, background)
        loss.backward()
        if offset.grad is not None:
            static_count = len(model.static)
            own = slice(static_count, self.count())
            for name, rows in (("static", slice(0, static_count)), ("dynamic", own)):
                if name in self.controls:
                    self.controls[name].record(offset.grad[rows], visible[rows], data.width, data.height)
        for optimiser in self.optimisers.values():
            optimiser.step()
        self.shared.step()
        self.shared.zero_grad(set_to_none=True)
        self._control_nodes()
        before = self.count(), self.next_id
        for control in self.controls.values():
            self.next_id = control.after_step(self.step, self.next_id, self.generator)
        if (self.count(), self.next_id) != before:
            model.topology_changed()
        return float(loss.detach())

    def _loss(self, frame: int, data: FrameData, background: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Total loss of a frame, the zero offsets whose gradient drives density control, and visibility (N,)."""
        config, model, weights = self.config, self.model, self.config.losses
        time = float(model.times[frame])
        view = model.rig.view(frame)
        intrinsics = model.rig.intrinsics(frame, data.width, data.height)
        moved, extra, partner = None, None, None
        if model.dynamic is not None:
            partner = self._track_partner(frame) if weights.track and self.step % config.track_every == 0 else None
            others = [] if partner is None else [float(model.times[partner])]
            poses = model.dynamic_at(time, *others)
            moved = poses[0]
        posed = model.posed(moved)
        if model.dynamic is not None:
            own = slice(len(model.static), self.count())
            extra = torch.zeros(len(posed.means), 1)
            extra[own] = 1
            if partner is not None:
                still = posed.means.detach()
                there = torch.cat([still[: own.start], poses[1][0], still[own.stop :]])
                extra = torch.cat([extra, there], 1)
        offset = torch.zeros(len(posed.means), 2, requires_grad=True)
        out = model.render(
            posed,
            view,
            intrinsics,
            data.width,
            data.height,
            extra=extra,
            background=background,
            mean2d_offset=offset,
            config=self.raster,
            backend=config.backend,
        )
        target = data.rgb[frame].float() / 255
        attention = 1 + (weights.moving - 1) * data.motion[frame].float()  # (H,W)
        loss = rgb_loss(out.channels[..., :3], target, attention, weights.ssim, model.threads)
        if weights.depth:
            confidence = data.confidence[frame].float()
            loss = loss + weights.depth * depth_loss(out.depth, out.alpha, data.depth[frame], confidence)
        if model.dynamic is not None:
            if weights.mask:
                motion = data.motion[frame].float()
                certain = (2 * motion - 1).abs()  # 0 where the score says nothing
                error = (out.channels[..., 3] - (motion > 0.5).float()).abs()
                loss = loss + weights.mask * (error * certain).mean()
            if partner is not None:
                loss = loss + weights.track * self._track_loss(frame, partner, out.channels[..., 4:7], out.alpha, data)
            if self.step % config.motion_every == 0:
                loss = loss + config.motion_every * self._motion_loss(frame)
        if weights.camera_smoothness:
            pixels = self.levels[0].width
            loss = loss + config.losses.camera_smoothness * model.rig.smoothness() * pixels
        return loss, offset, out.visible

    def _track_partner(self, frame: int) -> int | None:
        """A random other frame that shares moving tracks with `frame`."""
        shared = (self.tracks_visible & self.tracks_visible[frame]).sum(1)  # (F,)
        shared[frame] = 0
        candidates = (shared >= 8).nonzero()[:, 0]
        if len(candidates) == 0:
            return None
        return int(candidates[torch.randint(len(candidates), (1,), generator=self.generator)])

    def _track_loss(self, frame: int, partner: int, there: Tensor, alpha: Tensor, data: FrameData) -> Tensor:
        """Mean capped distance (full-size pixels) between the tracks in `partner` and what is rendered to move there.

        `there` (H,W,3): composited world positions at the partner's time, seen from `frame`.
        """
        both = self.tracks_visible[frame] & self.tracks_visible[partner]
        full = self.levels[0]
        size = torch.tensor([full.width, full.height], dtype=torch.float32)
        here = self.tracks[frame, both] / size * 2 - 1  # (n,2) in [-1,1], pixel edges at the ends
        maps = torch.cat([there, alpha[..., None]], -1).permute(2, 0, 1)[None]  # (1,4,H,W)
        sampled = torch.nn.functional.grid_sample(maps, here[None, None], align_corners=False)[0, :, 0].T  # (n,4)
        x = sampled[:, :3] / sampled[:, 3:].clamp_min(0.1)
        view = self.model.rig.view(partner)
        intrinsics = self.model.rig.intrinsics(partner, full.width, full.height)
        local = x @ view[:3, :3].T + view[:3, 3]
        z = local[:, 2:].clamp_min(1e-2)
        pixels = local[:, :2] / z * torch.stack([intrinsics[0, 0], intrinsics[1, 1]]) + intrinsics[:2, 2]
        distance = torch.linalg.vector_norm(pixels - self.tracks[partner, both], dim=1)
        return distance.clamp_max(TRACK_CLAMP).mean()

    def _motion_loss(self, frame: int) -> Tensor:
        """The physics-inspired losses on the frames around `frame`."""
        config, nodes, w = self.config, self.model.nodes, self.config.losses
        assert nodes is not None
        reach = max(config.shifts)
        window = slice(max(0, frame - reach), frame + reach + 1)
        xyz, quat = nodes.parameters["node_xyz"][window], nodes.quat[window]
        coordinate, length = arap_losses(xyz, quat, nodes.edges, config.shifts, config.shift_weights)
        smooth = smoothness_losses(xyz, quat, torch.from_numpy(self.model.times[window]))
        loss = w.arap_coordinate * coordinate + w.arap_length * length
        loss = loss + w.velocity * smooth.velocity + w.acceleration * smooth.acceleration
        loss = loss + w.rotation_velocity * smooth.angular_velocity
        loss = loss + w.rotation_acceleration * smooth.angular_acceleration
        if self.model.dynamic is not None and self.model.dynamic.use_dw:
            loss = loss + w.dw * self.model.dynamic.parameters["dw"].abs().mean()
        return loss

    def _rate(self, rate: Rate | float, share: float) -> float:
        """`rate` at this share of all steps; one that is a pair decays log-linearly, without the reference's jump."""
        if not isinstance(rate, tuple):
            return rate
        start = self.config.rate_decay_start
        decayed = min(max((share - start) / (1 - start), 0.0), 1.0)
        return math.exp((1 - decayed) * math.log(rate[0]) + decayed * math.log(rate[1]))

    def _rates(self, name: str, share: float) -> dict[str, float]:
        """Learning rates of the tensors of the set called `name` at this share of all steps."""
        tensors = dict(self._sets())[name].parameters
        return {tensor: self._rate(self.config.rates.of(name, tensor), share) for tensor in tensors}

    def _set_rates(self, share: float) -> None:
        """Learning rates at this share of all steps."""
        config = self.config
        for name, optimiser in self.optimisers.items():
            optimiser.set_rates(self._rates(name, share))
        for group in self.shared.param_groups:
            late = group["name"] in CAMERA_RATES and share < config.cameras_from
            rate = getattr(config.rates, {**NODE_RATES, **CAMERA_RATES}[group["name"]])
            group["lr"] = 0.0 if late else self._rate(rate, share)

    def _update_graph(self, share: float) -> None:
        """Rebuild the node graph now and then; freeze it when the skinning offsets begin to be learnt."""
        model, config = self.model, self.config
        if model.nodes is None or model.dynamic is None:
            return
        if model.dynamic.use_dw:
            return
        if share >= config.dw_from:
            model.dynamic.use_dw = True
        elif self.step and self.step % config.graph_every == 0:
            nodes = model.nodes
            model.nodes = NodeSet(with_graph(nodes.snapshot(), nodes.graph), nodes.graph, nodes.parameters)
            model.topology_changed()

    def _consider_harmonics(self) -> None:
        """At its steps, see whether one more degree of harmonics pays, and add it; one that is set by hand is added anyway."""
        config, degree = self.config, degree_of(self.model.static.sh.shape[1])
        most = config.most_sh_degree if config.sh_degree is None else config.sh_degree
        if degree >= min(most, len(config.harmonics_at)):
            return
        if self.step != round(config.harmonics_at[degree] * config.steps):
            return
        band = next_band(self.model, self.levels[0].rgb, self.raster, config.backend)
        self.band_gains.append(band.gain)
        if band.gain >= GAIN_DB or config.sh_degree is not None:
            first = 0
            for name, gaussians in self._sets():
                rows = slice(first, first + len(gaussians))
                self.optimisers[name].add_band(band.plain[rows], band.more[rows])
                first = rows.stop

    def _control_nodes(self) -> None:
        """Add and remove nodes at their steps."""
        model, config = self.model, self.config
        if model.nodes is None or model.dynamic is None:
            return
        if self.step in {round(share * config.steps) for share in config.nodes.add_at}:
            control = self.controls["dynamic"]
            gradient = control.gradient_sum / control.seen.clamp_min(1)
            self.next_node_id = add_nodes(
                model, self.optimisers["dynamic"], self.shared, gradient, config.nodes, self.next_node_id
            )
        if self.step in {round(share * config.steps) for share in config.nodes.drop_at}:
            drop_nodes(model, self.shared, config.nodes)

    def measure(self, loss: float) -> None:
        """Add one point to the quality curve: PSNR of a few supervised frames at full size."""
        count = len(self.model.times)
        frames = sorted({round(i * (count - 1) / max(MEASURED_FRAMES - 1, 1)) for i in range(MEASURED_FRAMES)})
        scores = [psnr(self.picture(frame), self.levels[0].rgb[frame].float() / 255) for frame in frames]
        self.history.append(
            {"step": self.step, "loss": loss, "psnr": float(np.mean(scores)), "gaussians": float(self.count())}
        )

    def picture(self, frame: int) -> Tensor:
        """(H,W,3) the model's picture of supervised frame `frame`, clamped to [0,1]."""
        model, data = self.model, self.levels[0]
        with torch.no_grad():
            moved = model.dynamic_at(float(model.times[frame]))[0] if model.dynamic is not None else None
            out = model.render(
                model.posed(moved),
                model.rig.view(frame),
                model.rig.intrinsics(frame, data.width, data.height),
                data.width,
                data.height,
                config=self.raster,
                backend=self.config.backend,
            )
        return out.channels[..., :3].clamp(0, 1)

    def _sets(self) -> Iterator[tuple[str, StaticGaussians | DynamicGaussians]]:
        yield "static", self.model.static
        if self.model.dynamic is not None:
            yield "dynamic", self.model.dynamic

    def state(self, config_hash: str) -> dict[str, Any]:
        """Everything that the next step depends on, as tensors and plain values."""
        model = self.model
        state: dict[str, Any] = {
            "config_hash": config_hash,
            "step": self.step,
            "next_id": self.next_id,
            "order": self.order,
            "generator": self.generator.get_state(),
            "history": json.dumps(self.history),
            "band_gains": self.band_gains,
            "cameras": {n: p.detach() for n, p in model.rig.parameters.items()},
            "shared": self.shared.state_dict(),
            "sets": {},
        }
        for name, gaussians in self._sets():
            control = self.controls[name]
            state["sets"][name] = {
                "parameters": {n: p.detach() for n, p in gaussians.parameters.items()},
                "labels": dict(gaussians.labels),
                "adam": self.optimisers[name].adam.state_dict(),
                "gradient_sum": control.gradient_sum,
                "seen": control.seen,
                "limit": control.limit,
            }
        if model.nodes is not None and model.dynamic is not None:
            state["use_dw"] = model.dynamic.use_dw
            state["nodes"] = {n: p.detach() for n, p in model.nodes.parameters.items()}
            state["next_node_id"] = self.next_node_id
            # The scaffold as it stood when its graph was built: its coarse edges follow from that state.
            state["scaffold"] = {
                name: torch.from_numpy(getattr(model.nodes.scaffold, name)) for name in SCAFFOLD_ARRAYS
            }
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state` was taken."""
        model = self.model
        with torch.no_grad():
            for name, value in state["cameras"].items():
                model.rig.parameters[name].copy_(value)
        for name, gaussians in self._sets():
            saved = state["sets"][name]
            gaussians.parameters = {n: p.clone().requires_grad_(True) for n, p in saved["parameters"].items()}
            gaussians.labels = dict(saved["labels"])
        if model.nodes is not None and model.dynamic is not None:
            model.dynamic.use_dw = state["use_dw"]
            self.next_node_id = state["next_node_id"]
            arrays = {name: tensor.numpy() for name, tensor in state["scaffold"].items()}
            parameters = {n: p.clone().requires_grad_(True) for n, p in state["nodes"].items()}
            scaffold = replace(model.nodes.scaffold, **arrays)
            model.nodes = NodeSet(scaffold, model.nodes.graph, parameters)
        model.topology_changed()
        self._start_optimisers()
        self.shared.load_state_dict(state["shared"])
        for name, _ in self._sets():
            saved = state["sets"][name]
            self.optimisers[name].adam.load_state_dict(saved["adam"])
            self.controls[name].gradient_sum = saved["gradient_sum"].clone()
            self.controls[name].seen = saved["seen"].clone()
            self.controls[name].limit = int(saved["limit"])
        self.generator.set_state(state["generator"])
        self.step, self.next_id, self.order = state["step"], state["next_id"], list(state["order"])
        self.history, self.band_gains = json.loads(state["history"]), list(state["band_gains"])
