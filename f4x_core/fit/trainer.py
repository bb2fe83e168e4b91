"""The training loop: all Gaussians, the scaffold and the cameras against the frames."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..clip import Clip
from ..errors import Cancelled
from ..gaussians import DensityControl, SetOptimiser
from ..gaussians.spawn import Room
from ..geometry.arrays import evenly_spaced
from ..geometry.spherical_harmonics import degree_of
from ..geometry.splats import Splats
from ..metrics.pictures import psnr
from ..priors import Priors
from ..progress import Progress, silent
from ..raster import RasterConfig, rasterize
from ..scaffold.adam import Adam
from ..scaffold.optimise import with_graph
from .averaging import RunningMeans
from .checkpoint import save_checkpoint
from .config import EndingConfig, FitConfig
from .frame_data import FrameData, MovingTracks, Window
from .harmonics import GAIN_DB, next_band
from .loss_terms import LossTerm, Rendered, loss_terms, total_loss
from .model import NodeSet, SceneModel
from .needs import Need
from .node_control import add_nodes, drop_nodes
from .schedule import Action, Moment, every, first_step_from, rate_at, steps_at

NODE_RATES = {"node_xyz": "node_xyz", "node_quat": "node_quat", "radius_logit": "radius"}
"""Parameter of the nodes -> its field of `RateConfig`."""
CAMERA_RATES = ("camera_rotation", "camera_position")
"""Parameters of the cameras, named as their fields of `RateConfig`."""
SAVED_SCAFFOLD = ("xyz", "quat", "radius", "certain", "ids", "neighbours", "edge_mask")
"""Arrays of the scaffold in a checkpoint."""
CLOSEUP_PIXELS = 0.3
"""Pixels of a close-up over those of the picture, at most: of what is larger it shows a part. Of the twelve real clips the windows
have .05 to .35."""
MEASURED_FRAMES = 4
"""Frames rendered for one point of the quality curve."""
USED_PER_ASIDE = 8
"""Used frames that a clip needs for each that is kept aside."""


@dataclass(frozen=True)
class FitStart:
    """Decisions made before the first step."""

    next_id: int
    """First Gaussian id not yet used."""
    needs: Sequence[Need] = ()
    """Decisions about the kind of scene, with their reasons."""
    rooms: Mapping[str, Room] = field(default_factory=dict)
    """Set -> how many Gaussians the clip asked for and how many were allowed."""


def frames_aside(frames: int, ending: EndingConfig) -> frozenset[int]:
    """Return which of so many used frames are kept aside; none where a fit does not end early."""
    if not (ending.min_gain and ending.at) or frames < USED_PER_ASIDE * ending.frames:
        return frozenset()
    return frozenset(evenly_spaced(frames, ending.frames + 2)[1:-1].tolist())


class Trainer:
    """Optimises a model against a clip and its priors; it can stop after any step and go on bit-equal.

    A step draws one frame, adds up the loss terms, and moves every parameter along its gradient. `actions` lists all that
    happens besides, with its steps.
    """

    def __init__(self, model: SceneModel, clip: Clip, priors: Priors, config: FitConfig, start: FitStart):
        """Set up data, losses, optimisers and actions for `config.steps` steps."""
        self.model, self.clip, self.priors, self.config = model, clip, priors, config
        self.next_id, self.needs, self.rooms = start.next_id, list(start.needs), dict(start.rooms)
        self.levels = [FrameData.full(clip, priors)]
        if config.coarse > 0:
            self.levels.append(self.levels[0].halved())
        self.tracks = MovingTracks.of(priors)
        self.losses: tuple[LossTerm, ...] = loss_terms(model, self.tracks, config)
        self.raster = RasterConfig(threads=model.kernels.threads)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.order: list[int] = []
        """Frames that are still to be drawn before each was drawn once more."""
        self.closeup_order: list[int] = []
        """The same for close-ups."""
        self.step = 0
        """Steps done."""
        self.loss = math.nan
        """Loss of the last step."""
        self.history: list[dict[str, float]] = []
        """The quality curve."""
        self.aside = frames_aside(len(model.times), config.ending)
        """Frames that are not drawn before the last moment of `config.ending`."""
        self.aside_psnr: list[float] = []
        """Mean PSNR (dB) of the frames kept aside, at each moment so far."""
        self.skipped = 0
        """Steps that were skipped because these frames gained no more."""
        self.band_gains: list[float] = []
        """dB that each degree of the harmonics, one after the other, would bring views from elsewhere."""
        self.next_node_id = int(model.nodes.scaffold.ids.max()) + 1 if model.nodes is not None else 0
        self.averages = RunningMeans()
        """Means of the dynamic parameters over the last steps."""
        self._start_optimisers()

    def _start_optimisers(self) -> None:
        config, model = self.config, self.model
        self.optimisers = {name: SetOptimiser(own, self._rates(name), model.kernels) for name, own in model.sets()}
        densities = {"static": config.density_static, "dynamic": config.density_dynamic}
        self.controls = {
            name: DensityControl(optimiser, densities[name], config.steps)
            for name, optimiser in self.optimisers.items()
        }
        groups = [{"params": [model.rig.parameters[n]], "lr": 0.0, "name": n} for n in CAMERA_RATES]
        if model.nodes is not None:
            groups += [{"params": [model.nodes.parameters[n]], "lr": 0.0, "name": n} for n in NODE_RATES]
        self.shared = Adam(groups, model.kernels)
        self.actions = self._schedule()

    def _schedule(self) -> list[Action]:
        """Return all that happens beside the gradient steps, in the order in which it happens."""
        config, total = self.config, self.config.steps
        start, optimised, done = Moment.START, Moment.OPTIMISED, Moment.DONE
        actions = [Action("learning rates", start, range(total), self._set_rates)]
        if self.model.dynamic is not None:
            freeze = first_step_from(config.dw_from, total)
            rebuilt = range(config.graph_every, freeze, config.graph_every)
            actions += [
                Action("graph rebuilt", start, rebuilt, self._rebuild_graph),
                Action("skinning offsets learnt", start, range(freeze, total), self._learn_offsets),
            ]
        actions.append(
            Action("harmonics considered", start, steps_at(config.harmonics_at, total), self._consider_harmonics)
        )
        if self.model.dynamic is not None:
            actions += [
                Action("nodes added", optimised, steps_at(config.nodes.add_at, total), self._add_nodes),
                Action("nodes dropped", optimised, steps_at(config.nodes.drop_at, total), self._drop_nodes),
            ]
        for name, control in self.controls.items():
            densify = partial(self._densify, name)
            actions.append(Action(f"density control, {name}", optimised, control.steps, densify))
        if self.model.dynamic is not None:
            last = range(first_step_from(config.average_from, total) + 1, total + 1)
            actions.append(Action("what moves averaged", done, last, self._average))
        if self.aside:
            actions.append(Action("end considered", done, steps_at(config.ending.at, total), self._consider_end))
        return [*actions, Action("quality measured", done, every(config.measure_every, total), self.measure)]

    def run(self, checkpoint: Path | None = None, settings_hash: str = "", progress: Progress = silent) -> None:
        """Train to the last step, writing `checkpoint` now and then; an interrupt leaves one behind."""
        total, saved_at = self.config.steps, every(self.config.checkpoint_every, self.config.steps)

        def save() -> None:
            if checkpoint is not None:
                save_checkpoint(checkpoint, self.state(settings_hash))

        whole = True  # inside a step there is nothing to continue from: then the last checkpoint stays
        try:
            while self.step < total:
                whole = False
                self.train_step()
                whole = True
                if self.step in saved_at:
                    save()
                progress("photometric", self.step, total, self._summary())
        except (KeyboardInterrupt, Cancelled):
            if whole:
                save()
            raise

    def _summary(self) -> str:
        """Return the quality when it was last measured."""
        if not self.history:
            return ""
        return f"{self.history[-1]['psnr']:.1f} dB, {int(self.history[-1]['gaussians']):,} Gaussians"

    def train_step(self) -> float:
        """Draw one frame, move the parameters along the gradient of its loss, do the actions; returns the loss."""
        self._act(Moment.START)
        frame, config = self._next_of(self.order, range(len(self.model.times))), self.config
        assert frame is not None, "a fit keeps a few frames aside, never all"
        data = self.levels[-1] if self.fraction < config.coarse else self.levels[0]
        rendered = self.render(frame, data, self._background())
        loss = total_loss(self.losses, self.step, rendered)
        loss.backward()
        self._record_gradients(rendered)
        for optimiser in self.optimisers.values():
            optimiser.step()
        self.shared.step()
        self.loss = float(loss.detach())
        if self.model.dynamic is not None:
            for _ in range(config.closeups):
                self._take_closeup(data)
        self._act(Moment.OPTIMISED)
        self.step += 1
        self._act(Moment.DONE)
        return self.loss

    def _act(self, moment: Moment) -> None:
        for action in self.actions:
            if action.moment is moment and self.step in action.steps:
                action.run()

    @property
    def fraction(self) -> float:
        """The fraction of all steps that are done."""
        return self.step / self.config.steps

    def _take_closeup(self, data: FrameData) -> None:
        """Draw the window around what moves in another frame, and move dynamic Gaussians and nodes along the gradient."""
        full = self.levels[0]
        frame = self._next_of(self.closeup_order, full.moving_windows)
        if frame is None:
            return
        window = full.moving_windows[frame].part(int(CLOSEUP_PIXELS * full.width * full.height), self.generator)
        rendered = self.render(frame, data, self._background(), window if data is full else window.halved())
        total_loss([term for term in self.losses if not term.whole], self.step, rendered).backward()
        self.optimisers["dynamic"].step()
        self.shared.step()

    def _background(self) -> Tensor | None:
        """Return the color (3,) behind the next picture."""
        return torch.rand(3, generator=self.generator) if self.config.random_background else None

    def _next_of(self, order: list[int], frames: Iterable[int]) -> int | None:
        """Take the next frame out of `order`, which is filled with `frames` in random order whenever it is empty.

        None: all `frames` are kept aside.
        """
        if not order:
            order += self._shuffled(frames)
        return order.pop() if order else None

    def _shuffled(self, frames: Iterable[int]) -> list[int]:
        """Return the frames in random order, without those that are kept aside now."""
        kept = self.aside if self.aside and self.step < max(steps_at(self.config.ending.at, self.config.steps)) else ()
        listed = list(frames)
        order = torch.randperm(len(listed), generator=self.generator).tolist()
        return [listed[place] for place in order if listed[place] not in kept]

    def render(
        self, frame: int, data: FrameData, background: Tensor | None = None, window: Window | None = None
    ) -> Rendered:
        """Return supervised frame `frame` at the size of `data`, with all channels that the losses of the present step ask for.

        `background`: (3,) rgb. With a `window`, that part of it alone, for losses of dynamic Gaussians and nodes: static ones
        and the camera get no gradient then.
        """
        config, model = self.config, self.model
        moved, there, partner, present = None, None, None, None
        if model.dynamic is not None:
            if window is None and any(term.name == "track" and term.due(self.step) for term in self.losses):
                partner = self.tracks.random_partner(frame, self.generator)
            times = [float(model.times[index]) for index in (frame, partner) if index is not None]
            present = model.present_at(times[0])
            moved, *others = model.dynamic_at(*times, present=present)
            there = others[0].means if others else None
        camera, target = model.rig.camera(frame, data.width, data.height), data.target(frame)
        if window is not None:
            camera, target = window.seen_by(camera), target.within(window).near_movers()
            camera = replace(camera, world_to_camera=camera.world_to_camera.detach())
        drawn = model.drawn(moved, camera, there, still=window is not None)
        offset = torch.zeros(len(drawn.means), 2, requires_grad=True)
        if background is not None:
            background = torch.cat([background, background.new_zeros(drawn.colors.shape[1] - len(background))])
        output = rasterize(
            Splats(drawn.means, drawn.quats, drawn.scales, drawn.opacities),
            drawn.colors,
            camera,
            background=background,
            mean2d_offset=offset,
            config=self.raster,
            backend=config.backend,
        )
        return Rendered(target, output, partner, self.step, offset, present)

    def _record_gradients(self, rendered: Rendered) -> None:
        """Hand the screen-space gradients to density control."""
        assert rendered.offset is not None
        pulls, visible, present = rendered.offset.grad, rendered.output.visible, rendered.present
        if pulls is None:
            return
        height, width = rendered.on.rgb.shape[:2]
        count = len(self.model.static)
        self.controls["static"].record(pulls[:count], visible[:count], width, height)
        if present is not None:
            own = slice(count, count + len(present.gaussians))
            self.controls["dynamic"].record(pulls[own], visible[own], width, height, present.rows)

    def _rates(self, name: str) -> dict[str, float]:
        """Return the learning rates of the tensors of the set called `name` at the present step."""
        tensors = dict(self.model.sets())[name].parameters
        return {t: rate_at(self.config.rates.of(name, t), self.fraction, self.config) for t in tensors}

    def _set_rates(self) -> None:
        config = self.config
        for name, optimiser in self.optimisers.items():
            optimiser.set_rates(self._rates(name))
        for group in self.shared.param_groups:
            late = group["name"] in CAMERA_RATES and self.fraction < config.cameras_from
            rate = getattr(config.rates, NODE_RATES.get(group["name"], group["name"]))
            group["lr"] = 0.0 if late else rate_at(rate, self.fraction, config)

    def _rebuild_graph(self) -> None:
        nodes = self.model.nodes
        assert nodes is not None
        self.model.nodes = NodeSet(with_graph(nodes.snapshot(), nodes.graph), nodes.graph, nodes.parameters)

    def _learn_offsets(self) -> None:
        """Learn the offsets of skinning weights; the graph is frozen from here on, because they belong to its edges."""
        assert self.model.dynamic is not None
        self.model.dynamic.use_dw = True

    def _consider_harmonics(self) -> None:
        """Add one more degree of harmonics if it pays; one that is set by hand is added anyway."""
        config, degree = self.config, degree_of(self.model.static.sh.shape[1])
        allowed = config.max_sh_degree if config.sh_degree is None else config.sh_degree
        if degree >= min(allowed, len(config.harmonics_at)):
            return
        if self.step != round(config.harmonics_at[degree] * config.steps):
            return
        band = next_band(self.model, self.levels[0].rgb, self.raster, config.backend)
        self.band_gains.append(band.gain)
        if band.gain >= GAIN_DB or config.sh_degree is not None:
            for name, rows in self.model.rows():
                self.optimisers[name].add_band(band.plain[rows], band.more[rows])

    def _add_nodes(self) -> None:
        control = self.controls["dynamic"]
        gradient = control.gradient_sum / control.seen.clamp_min(1)
        self.next_node_id = add_nodes(
            self.model, self.optimisers["dynamic"], self.shared, gradient, self.config.nodes, self.next_node_id
        )

    def _drop_nodes(self) -> None:
        drop_nodes(self.model, self.shared, self.config.nodes)

    def _average(self) -> None:
        """Add the dynamic parameters to their running means; after the last step, put the means in their place."""
        assert self.model.dynamic is not None and self.model.nodes is not None
        moving = {**self.model.dynamic.parameters, **self.model.nodes.parameters}
        self.averages.add(moving)
        if self.step == self.config.steps:
            self.averages.put(moving)

    def _densify(self, name: str) -> None:
        self.next_id = self.controls[name].densify_and_prune(self.next_id)

    def _consider_end(self) -> None:
        """Skip the steps up to `goes_on_at` when the frames kept aside have gained too little since the last moment."""
        ending, total = self.config.ending, self.config.steps
        self.aside_psnr.append(self._mean_psnr(sorted(self.aside)))
        gains = np.diff(self.aside_psnr)
        if len(gains) and gains[-1] < ending.min_gain:
            goes_on = max(round(ending.goes_on_at * total), self.step)
            self.skipped, self.step, self.order = goes_on - self.step, goes_on, []

    def _mean_psnr(self, frames: Sequence[int]) -> float:
        """Return the mean PSNR (dB) of supervised `frames` at full size."""
        full = self.levels[0]
        scores = [psnr(self.picture(frame), full.rgb[frame].float() / 255, full.seen(frame)) for frame in frames]
        return float(np.nanmean(scores))

    def measure(self) -> None:
        """Add one point to the quality curve: PSNR of a few supervised frames at full size."""
        frames = evenly_spaced(len(self.model.times), MEASURED_FRAMES).tolist()
        point = {"step": self.step, "loss": self.loss, "psnr": self._mean_psnr(frames)}
        self.history.append({**point, "gaussians": float(len(self.model))})

    def picture(self, frame: int) -> Tensor:
        """Return (H,W,3) the model's picture of supervised frame `frame`, clamped to [0,1]."""
        model, data = self.model, self.levels[0]
        with torch.no_grad():
            moved = model.dynamic_at(float(model.times[frame]))[0] if model.dynamic is not None else None
            camera = model.rig.camera(frame, data.width, data.height)
            out = model.render(model.posed(moved), camera, config=self.raster, backend=self.config.backend)
        return out.channels[..., :3].clamp(0, 1)

    def state(self, settings_hash: str) -> dict[str, Any]:
        """Return everything that the next step depends on, as tensors and plain values."""
        model = self.model
        state: dict[str, Any] = {
            "config_hash": settings_hash,
            "step": self.step,
            "next_id": self.next_id,
            "order": self.order,
            "closeup_order": self.closeup_order,
            "generator": self.generator.get_state(),
            "history": json.dumps(self.history),
            "band_gains": self.band_gains,
            "aside_psnr": self.aside_psnr,
            "skipped": self.skipped,
            "cameras": {n: p.detach() for n, p in model.rig.parameters.items()},
            "shared": self.shared.state_dict(),
            "averages": self.averages.state(),
            "sets": {},
        }
        for name, gaussians in model.sets():
            control = self.controls[name]
            state["sets"][name] = {
                "parameters": {n: p.detach() for n, p in gaussians.parameters.items()},
                "labels": dict(gaussians.labels),
                "adam": self.optimisers[name].adam.state_dict(),
                "gradient_sum": control.gradient_sum,
                "seen": control.seen,
                "limit": control.limit,
                "lacking": control.lacking,
            }
        if model.nodes is not None and model.dynamic is not None:
            state["use_dw"] = model.dynamic.use_dw
            state["nodes"] = {n: p.detach() for n, p in model.nodes.parameters.items()}
            state["next_node_id"] = self.next_node_id
            # The scaffold as it stood when its graph was built: its coarse edges follow from that state.
            state["scaffold"] = {name: torch.from_numpy(getattr(model.nodes.scaffold, name)) for name in SAVED_SCAFFOLD}
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state` was taken."""
        model = self.model
        with torch.no_grad():
            for name, value in state["cameras"].items():
                model.rig.parameters[name].copy_(value)
        for name, gaussians in model.sets():
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
        self.step, self.next_id, self.order = state["step"], state["next_id"], list(state["order"])
        self.closeup_order = list(state["closeup_order"])
        self._start_optimisers()
        self.shared.load_state_dict(state["shared"])
        self.averages.restore(state["averages"])
        for name, optimiser in self.optimisers.items():
            saved = state["sets"][name]
            optimiser.adam.load_state_dict(saved["adam"])
            self.controls[name].gradient_sum = saved["gradient_sum"].clone()
            self.controls[name].seen = saved["seen"].clone()
            self.controls[name].limit, self.controls[name].lacking = int(saved["limit"]), int(saved["lacking"])
        self.generator.set_state(state["generator"])
        self.history, self.band_gains = json.loads(state["history"]), list(state["band_gains"])
        self.aside_psnr, self.skipped = list(state["aside_psnr"]), state["skipped"]
