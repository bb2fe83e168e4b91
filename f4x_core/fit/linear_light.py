"""Refits a scene's scales, opacities and colours for renderers that blend in linear light without a footprint (`scene.linear`).

The target is the scene's own picture: what the rasterizer draws of the fitted arrays is to be what Blender 5.3's Cycles draws of
the refitted ones. So neither clip nor priors are needed, and any camera may look: half of the views are the clip's, half lie
aside. Centres, rotations and higher harmonics stay, and with them motion, selections and edits.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import F4xError
from ..features.memory import memory_guard
from ..geometry import spherical_harmonics, trajectory
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..native.kernels import torch_threads
from ..native.library import open_library
from ..progress import Progress, silent
from ..raster import rasterize
from ..raster.contract import RasterConfig
from ..raster.rays import RayConfig, filtered_rays
from ..scaffold.adam import Adam
from ..scene import PosedSplats, Scene
from ..scene.linear import Look, linear_look, with_look
from ..scene.model import faded
from .checkpoint import load_checkpoint, save_checkpoint
from .linear_config import LinearConfig

MIN_OPACITY = 0.011
"""Smallest opacity at the start: below .01 Cycles draws nothing, and no gradient comes back."""
MAX_OPACITY = 0.999
STAGE = "linear light"
"""Name of the stage in progress reports."""


def refit(
    scene: Scene,
    config: LinearConfig | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> Scene:
    """Return the scene with an appearance for linear light stored in it (`scene.linear.with_look`); all else is as it was.

    Args:
        scene: its edits stay, but the unedited Gaussians are what is refitted.
        config: settings.
        checkpoint: file that the state is written to every `save_every` steps, and that `resume` goes on from; the result is the
            same to the bit. It is deleted at the end.
        resume: whether to go on from `checkpoint` if it is there.
        progress: told of the steps; it may cancel.

    Raises:
        F4xError: the compiled library is missing, memory ran out, the checkpoint is of another scene or of other settings, or
            it is not known how the scene was fitted.
    """
    config = config or LinearConfig()
    if open_library()[0] is None:
        raise F4xError(f"Refitting for linear light needs the compiled kernels: {open_library()[1]}.")
    if scene.fitted_focal(float(scene.cameras.times[0])) is None:
        raise F4xError(
            f"The scene '{scene.name}' was imported as splats: without the cameras of its pictures there is nothing to refit it to."
        )
    what = f"Refitting {len(scene.base.ids):,} Gaussians"
    with memory_guard(what), torch_threads(1):  # torch's sums depend on its threads
        return with_look(scene, _Refit(scene.base, config).run(checkpoint, resume, progress))


class _Refit:
    """The parameters and their optimiser."""

    def __init__(self, scene: Scene, config: LinearConfig):
        """Begin where the fitted appearance with its footprint in the scales is."""
        start = linear_look(with_look(scene, None))
        self.scene, self.config = scene, config
        self.log_scales = torch.from_numpy(np.log(np.maximum(start.scales, 1e-9))).requires_grad_()
        opacities = torch.from_numpy(start.opacities).clamp(MIN_OPACITY, MAX_OPACITY)
        self.opacity_logits = torch.logit(opacities).requires_grad_()
        self.there = torch.from_numpy(start.opacities > 0)
        self.color_shift = torch.zeros(len(opacities), 3, requires_grad=True)
        self.start = start
        self.rates = (config.scale_rate, config.opacity_rate, config.color_rate)
        groups: list[dict[str, Any]] = [
            {"params": [p], "lr": r} for p, r in zip(self.parameters, self.rates, strict=True)
        ]
        self.adam = Adam(groups)
        threads = {"threads": config.threads} if config.threads else {}
        self.fitted_rule, self.rays = RasterConfig(**threads), RayConfig(**threads)  # type: ignore[arg-type]

    @property
    def parameters(self) -> tuple[Tensor, Tensor, Tensor]:
        """The refitted tensors: logarithms of scales, logits of opacities, shifts of colours."""
        return self.log_scales, self.opacity_logits, self.color_shift

    @property
    def key(self) -> str:
        """Hash of the scene and of the settings that change the result, for checkpoints."""
        settings = {name: value for name, value in asdict(self.config).items() if name not in ("threads", "save_every")}
        digest = hashlib.sha256(repr(settings).encode())
        for held in (self.scene.static, self.scene.dynamic):
            for array in held.arrays().values():
                digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def run(self, checkpoint: Path | None, resume: bool, progress: Progress) -> Look:
        """Run all steps from the last checkpoint, and return the appearance."""
        key, begun = self.key, 0
        state = load_checkpoint(checkpoint, key) if checkpoint is not None and resume else None
        if state is not None:
            begun = state["step"]
            self.adam.load_state_dict(state["adam"])
            with torch.no_grad():
                for held, kept in zip(self.parameters, state["parameters"], strict=True):
                    held.copy_(kept)
        for step in range(begun, self.config.steps):
            progress(STAGE, step, self.config.steps)
            self._step(step)
            if checkpoint is not None and (step + 1) % self.config.save_every == 0:
                kept = {"step": step + 1, "adam": self.adam.state_dict(), "parameters": list(self.parameters)}
                save_checkpoint(checkpoint, {"config_hash": key, **kept})
        progress(STAGE, self.config.steps, self.config.steps)
        if checkpoint is not None:
            checkpoint.unlink(missing_ok=True)
        return self.look()

    def look(self) -> Look:
        """Return the appearance as it is now."""
        with torch.no_grad():
            dc = self.start.dc + spherical_harmonics.dc_from_rgb(self.color_shift.numpy() + 0.5)
            opacities = torch.where(self.there, torch.sigmoid(self.opacity_logits), 0.0)
            return Look(self.log_scales.exp().numpy(), opacities.numpy(), dc.astype(np.float32))

    def _step(self, step: int) -> None:
        for group, rate in zip(self.adam.param_groups, self.rates, strict=True):
            group["lr"] = rate * self.config.last_rate ** (step / self.config.steps)
        camera, time = self._view(step)
        posed = self.scene.posed(time)
        colors = self.scene.colors(posed, camera).astype(np.float32)
        wanted = rasterize(posed, colors, camera, config=self.fitted_rule)
        drawn = self._draw(posed, torch.from_numpy(colors), camera, time)
        target = torch.from_numpy(np.concatenate([wanted.channels.clip(0, 1), wanted.alpha[..., None]], 2))
        error = torch.cat((display_color(drawn[..., :3]), drawn[..., 3:]), 2) - target
        (error**2).mean().backward()
        self.adam.step()

    def _draw(self, posed: PosedSplats, colors: Tensor, camera: Camera, time: float) -> Tensor:
        """Return (H,W,4) linear colours and alpha as a renderer for linear light draws them."""
        opacities = torch.where(self.there, torch.sigmoid(self.opacity_logits), 0.0)
        if self.scene.fades:
            opacities = 1 - (1 - opacities) ** torch.from_numpy(self.scene.presence(time))
        splats = Splats(torch.from_numpy(posed.means), torch.from_numpy(posed.quats), self.log_scales.exp(), opacities)
        return filtered_rays(splats, linear_color(colors + self.color_shift), camera, self.config.oversample, self.rays)

    def _view(self, step: int) -> tuple[Camera, float]:
        """Return a part of the clip's picture at a moment, or, every second time, of a view from aside."""
        rng = np.random.default_rng([self.config.seed, step])
        time = float(rng.choice(self.scene.cameras.times))
        right, up = rng.uniform(-self.config.aside, self.config.aside, 2)
        whole = self.scene.cameras.at(time)
        if step % 2:
            whole = trajectory.aside(self.scene.cameras, time, right=right, up=up).camera
        width, height = (max(1, round(self.config.part * side)) for side in (whole.width, whole.height))
        intrinsics = np.array(whole.intrinsics, np.float64)
        intrinsics[0, 2] -= rng.integers(whole.width - width + 1)
        intrinsics[1, 2] -= rng.integers(whole.height - height + 1)
        return replace(whole, intrinsics=intrinsics, width=width, height=height), time


def linear_color(display: Tensor) -> Tensor:
    """Return linear light of display colours, which below 0 have none (IEC 61966-2-1)."""
    display = display.clamp_min(0)
    return torch.where(display <= 0.04045, display / 12.92, ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def display_color(linear: Tensor) -> Tensor:
    """Return the inverse of `linear_color`."""
    return torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def agreement(scene: Scene, count: int = 6) -> list[float]:
    """Return the PSNR (dB) of `count` views of the clip: the linear appearance, drawn as Cycles does, against the fitted one."""
    look, fitted = linear_look(scene), scene.base
    _, steady = fitted.full_appearance
    times = fitted.cameras.times[np.linspace(0, len(fitted.cameras) - 1, count).round().astype(int)]
    found = []
    with torch_threads(1):
        for time in map(float, times):
            camera, posed = fitted.cameras.at(time), fitted.posed(time)
            colors = fitted.colors(posed, camera).astype(np.float32)
            wanted = rasterize(posed, colors, camera).channels.clip(0, 1)
            shift = spherical_harmonics.rgb_from_dc(look.dc) - spherical_harmonics.rgb_from_dc(steady[:, 0])
            light = linear_color(torch.from_numpy(colors + shift.astype(np.float32)))
            opacities = faded(look.opacities, fitted.presence(time))
            splats = Splats(*map(torch.from_numpy, (posed.means, posed.quats, look.scales, opacities)))
            drawn = display_color(filtered_rays(splats, light, camera, 3)[..., :3]).numpy()
            found.append(float(-10 * np.log10(np.mean((drawn - wanted) ** 2))))
    return found
