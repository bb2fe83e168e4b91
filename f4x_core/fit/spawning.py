"""The first Gaussians of a fit: as many as the clip shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.ndimage import binary_dilation
from torch import Tensor

from ..clip import Clip
from ..gaussians import DynamicGaussians, SpawnConfig, Spawned, StaticGaussians, spawn_dynamic, spawn_static
from ..gaussians.parameters import WHOLE
from ..gaussians.spawn import DepthImage, Room, coarse_to_fine, cover, spawn_that_fits
from ..geometry.arrays import evenly_spaced
from ..priors import Priors
from ..priors.sizes import DepthMap, LargeMaps
from ..progress import Progress
from .config import FitConfig
from .model import SceneModel

MASK_MARGIN = 2
"""Static Gaussians are not spawned this close (pixels) to the moving mask, whose edge is uncertain."""
SURE_DEPTH, LOOSEST_DEPTH = 0.14, 0.5
"""Relative error of depth whose confidence is one half, and the largest difference in depth at which a Gaussian still covers."""
CARRIED = 0.5
"""Fraction of its nodes that must be seen in a frame for a moving Gaussian to cover it there: where tracks have ended, its place is
a guess. Without this, breakdance (`quick`, 84 frames) has 14.2 dB on the dancer and lifetimes alone bring 1.2; with it, .4 more."""
CRUMBS = 0.1
"""Fraction of what a frame alone would need, below which a frame between the chosen ones is covered: crumbs of all frames would be
a third more Gaussians (dog, -.1 dB held out), while fast motion leaves a third of each frame open (breakdance, +1.3 dB)."""
BEYOND, SHORTEST = 1.25, 2.0
"""Lifetimes at the start of Gaussians that are carried to the clip's end as multiples of the time to it; the shortest in frames."""
Explained = Mapping[int, np.ndarray]
"""(H,W) bool by supervised frame: pixels that are shown rightly already."""


def spawn_frames(priors: Priors, config: FitConfig) -> np.ndarray:
    """Return the indices into F of the frames from which the static set is spawned."""
    count = min(config.spawn_static.frames, len(priors.frames))
    return evenly_spaced(len(priors.frames), count)


def first_lifetimes(times: np.ndarray, reference: np.ndarray, carried: np.ndarray) -> Tensor:
    """Return (N,2) logarithms of lifetimes, to be learnt: whole while `carried (F,N)` bool lasts around the `reference (N,)` frame.

    Where that is to the clip's end, they end beyond it and begin to fade in it: only ramps have gradients. `times (F,)`: those
    of the frames.
    """
    frames, row = np.arange(len(times))[:, None], np.arange(len(reference))
    lost = ~carried
    lost[reference, row] = False
    born, sides = times[reference], []
    for end, beyond in ((0, frames < reference), (len(times) - 1, frames > reference)):
        apart = np.where(lost & beyond, np.abs(times[:, None] - born), np.inf).min(
            0
        )  # (N,) to the first frame that is lost
        sides.append(np.where(np.isfinite(apart), apart / WHOLE, BEYOND * np.abs(times[end] - born)))
    return torch.from_numpy(np.log(np.maximum(np.stack(sides, 1), SHORTEST)).astype(np.float32)).requires_grad_(True)


@dataclass
class Spawner:
    """Spawns the first Gaussians of a fit: as dense as the clip asks for, or thinner where the budget is too small."""

    clip: Clip
    priors: Priors
    config: FitConfig
    degree: int
    progress: Progress
    rooms: dict[str, Room] = field(default_factory=dict, init=False)
    """Set -> Gaussians that it asked for and Gaussians that it was allowed."""

    @property
    def maps(self) -> LargeMaps:
        """The maps of the priors at the size of the clip."""
        return LargeMaps(self.priors, self.clip.width, self.clip.height)

    def static(self, moving: bool, explained: Explained | None, first_id: int) -> StaticGaussians:
        """Spawn static Gaussians from frames all over the clip, outside the mask of moving objects where there is one."""
        chosen = spawn_frames(self.priors, self.config)

        def cover_all(spawn: SpawnConfig) -> Spawned:
            rng, parts = np.random.default_rng(self.config.seed), [Spawned.joined([])]
            for done, which in enumerate(coarse_to_fine(len(chosen))):
                self.progress("spawn", done, len(chosen), "static")
                frame = int(chosen[which])
                seen = self.maps.depth(frame)
                valid = seen.known
                if moving and self.priors.mask is not None:
                    valid &= ~binary_dilation(self.maps.mask(frame), iterations=MASK_MARGIN)
                if explained is not None:
                    valid &= ~explained[frame]
                parts = [
                    Spawned.joined(parts),
                    self._cover(frame, seen, valid, Spawned.joined(parts).means, spawn, rng),
                ]
            return Spawned.joined(parts)

        start = spawn_that_fits(cover_all, self.config.start_of("static"))
        self.rooms["static"] = start.room
        self.progress("spawn", len(chosen), len(chosen), "static")
        return spawn_static(start.made, self.degree, start.config, first_id)

    def dynamic(self, model: SceneModel, first_id: int) -> DynamicGaussians:
        """Spawn dynamic Gaussians: each visited frame fills what the Gaussians of earlier ones, moved there, leave open.

        After frames spread over the clip, as many as the config says, come those between them that still leave much open.

        `model` has the static Gaussians, the nodes and the cameras.
        """
        assert self.priors.mask is not None
        assert model.nodes is not None
        with_motion = np.flatnonzero(self.priors.mask.any((1, 2)))
        count = min(self.config.spawn_dynamic.frames, len(with_motion))
        chosen = with_motion[evenly_spaced(len(with_motion), count)]
        order = [*chosen[list(coarse_to_fine(count))], *np.setdiff1d(with_motion, chosen)]

        def cover_all(spawn: SpawnConfig) -> DynamicGaussians:
            rng = np.random.default_rng(self.config.seed)
            dynamic: DynamicGaussians | None = None
            density = 0.0
            for done, frame in enumerate(map(int, order)):
                self.progress("spawn", done, len(order), "dynamic")
                existing = self._moved(model, dynamic, frame)
                seen = self.maps.depth(frame)
                valid = seen.known & self.maps.mask(frame)
                found = self._cover(frame, seen, valid, existing, spawn, rng)
                density = len(found) / max(valid.sum(), 1) if dynamic is None else density
                if done >= count and len(found) < CRUMBS * density * valid.sum():
                    continue
                more = self._carried(model, found, frame, spawn, first_id + (0 if dynamic is None else len(dynamic)))
                dynamic = more if dynamic is None else dynamic.followed_by(more)
            assert dynamic is not None
            return dynamic

        start = spawn_that_fits(cover_all, self.config.start_of("dynamic"))
        self.rooms["dynamic"], dynamic = start.room, start.made
        if self.config.rates.lifetimes:
            carried = np.stack([self._seen_at(model, dynamic, frame) for frame in range(len(model.times))])
            first = first_lifetimes(model.times, dynamic.labels["reference"].numpy(), carried)
            dynamic.parameters["log_lifetimes"] = first
        self.progress("spawn", len(order), len(order), "dynamic")
        return dynamic

    def _cover(
        self,
        frame: int,
        seen: DepthMap,
        valid: np.ndarray,
        existing: np.ndarray,
        spawn: SpawnConfig,
        rng: np.random.Generator,
    ) -> Spawned:
        """Gaussians for the pixels `valid (H,W)` of supervised frame `frame`, of depth `seen`, that `existing` leaves open."""
        priors = self.priors
        assert priors.cameras is not None
        image = self.clip.frames[priors.frames[frame]]
        camera = priors.cameras[frame].resized(self.clip.width, self.clip.height)
        tolerance = None
        if priors.depth_confidence is not None:
            sure = np.maximum(seen.confidence.astype(np.float32), 0.01)
            tolerance = np.clip(2 * np.sqrt((1 - sure) / sure) * SURE_DEPTH, spawn.depth_tolerance, LOOSEST_DEPTH)
        view = DepthImage(image, seen.depth, valid, camera, tolerance)
        return cover(view, existing, spawn, rng)

    def _carried(
        self, model: SceneModel, spawned: Spawned, frame: int, spawn: SpawnConfig, first_id: int
    ) -> DynamicGaussians:
        """Return the Gaussians that were spawned in supervised frame `frame`, attached to the model's nodes."""
        assert model.nodes is not None
        reference = np.full(len(spawned), frame)
        return spawn_dynamic(spawned, reference, model.nodes.snapshot(), self.degree, spawn, first_id)

    def _moved(self, model: SceneModel, dynamic: DynamicGaussians | None, frame: int) -> np.ndarray:
        """Return (N,3) places of the dynamic Gaussians so far at supervised frame `frame`."""
        if dynamic is None or not len(dynamic):
            return np.zeros((0, 3), np.float32)
        with torch.no_grad():
            places = replace(model, dynamic=dynamic).dynamic_at(float(model.times[frame]))[0].means.numpy()
        if not self.config.rates.lifetimes:
            return places
        return places[self._seen_at(model, dynamic, frame)]

    def _seen_at(self, model: SceneModel, dynamic: DynamicGaussians, frame: int) -> np.ndarray:
        """Return (N,) bool: the nodes of a Gaussian are seen in the supervised frame `frame`."""
        assert model.nodes is not None
        return model.nodes.scaffold.certain[frame][model.nodes.neighbours[dynamic.labels["attach"]]].mean(1) >= CARRIED
