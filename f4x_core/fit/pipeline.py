"""From a clip to fitted arrays: priors, needs, scaffold, spawning, photometric stage; each stage can be resumed."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import binary_dilation

from .. import __version__
from ..clip import Clip
from ..errors import F4xError
from ..gaussians import DynamicGaussians, SpawnConfig, Spawned, StaticGaussians, spawn_dynamic, spawn_static
from ..gaussians.spawn import coarse_to_fine, cover, spawn_that_fits
from ..geometry import quaternion
from ..geometry.camera import CameraPath
from ..geometry.spherical_harmonics import degree_of
from ..priors import Priors, build_priors
from ..priors.config import config_hash
from ..progress import Progress, silent
from ..raster import choose_backend
from ..scaffold import Scaffold
from ..scene import DynamicSet, Scene, StaticSet
from .checkpoint import load_checkpoint
from .config import FitConfig, resolved
from .earlier import Backdrop, Earlier
from .harmonics import GAIN_DB
from .model import CameraRig, NodeSet, SceneModel
from .needs import Need, moving_share
from .photometric import PhotometricStage
from .start import start_scaffold

# With fewer supervised frames nothing about motion or parallax can be told apart.
LEAST_FRAMES = 3
# Smaller pictures hold no pattern that flow could follow.
LEAST_SIDE = 16
# Static Gaussians are not spawned this close (pixels) to the moving mask, whose edge is uncertain.
MASK_MARGIN = 2
# Relative error of depth whose confidence is one half, and the largest difference in depth at which a Gaussian still covers.
SURE_DEPTH, LOOSEST_DEPTH = 0.14, 0.5


@dataclass
class FitResult:
    """What a fit leaves, as numpy arrays in the layout of the scene file."""

    static: dict[str, np.ndarray]
    """Arrays of the static set."""
    dynamic: dict[str, np.ndarray] | None
    """Arrays of the dynamic set; None where nothing moves."""
    scaffold: Scaffold | None
    """The fitted scaffold; None where nothing moves."""
    cameras: CameraPath
    """One camera per clip frame; held-out ones interpolated between the refined ones."""
    needs: list[Need]
    """What was modelled and why."""
    priors: Priors
    """The priors it was fitted to."""
    history: list[dict[str, float]]
    """Quality curve of the photometric stage."""
    provenance: dict[str, Any]
    """Who made what with which settings."""
    next_id: int
    """First Gaussian id never used."""
    seconds: dict[str, float]
    """Wall time per stage of this call."""

    def scene(self, clip: Clip) -> Scene:
        """The fitted arrays as a scene."""
        return Scene(
            name=clip.name,
            static=StaticSet(**self.static),
            dynamic=DynamicSet(**self.dynamic) if self.dynamic is not None else DynamicSet.empty(),
            scaffold=self.scaffold,
            cameras=self.cameras,
            fps=clip.fps,
            held_out=tuple(int(i) for i in clip.held_out.nonzero()[0]),
            provenance=self.provenance,
            needs=tuple(need.row() for need in self.needs),
            next_id=self.next_id,
        )


def fit_clip(
    clip: Clip,
    folder: Path,
    config: FitConfig,
    progress: Progress = silent,
    resume: bool = False,
    earlier: Earlier | None = None,
) -> FitResult:
    """Fit `clip`, keeping priors and checkpoints in `folder`; `earlier` is the window that a window of a long clip goes on from.

    Raises:
        F4xError: a clip that `require_enough` refuses, unusable priors, or a checkpoint that does not belong to this clip
            and these settings.
    """
    require_enough(clip)
    choose_backend(config.backend)
    # The compiled library brings its own threads; torch's beside them gain nothing and collapse when other work wants the cores.
    torch.set_num_threads(1 if config.native_threads else config.all_threads)
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal clock
        seconds[name] = round(time.perf_counter() - clock, 2)
        clock = time.perf_counter()

    settings = {k: v for k, v in resolved(config).items() if k not in ("checkpoint_every", "measure_every")}
    key = config_hash(settings, clip.digest, clip.width, clip.height, *([] if earlier is None else [earlier.digest]))
    checkpoint = folder / "checkpoints" / "photometric.pt"
    if resume:
        load_checkpoint(checkpoint, key)  # what cannot be continued is told before minutes of priors
    seen_depth = None if earlier is None else earlier.depth(clip, config.backend)
    priors = build_priors(clip, folder / "priors", config.priors, progress, seen_depth)
    lap("priors")
    key += config_hash({name: entry.get("digest") for name, entry in priors.provenance.items()})
    state = load_checkpoint(checkpoint, key) if resume else None
    backdrop = None
    if earlier is not None:
        priors = earlier.track(clip, earlier.place(priors, config.backend), MASK_MARGIN, config.backend)
        rows = _spawn_frames(priors, config)
        backdrop = earlier.backdrop(clip, priors, rows, MASK_MARGIN, config.backend)
    first_id = 0 if earlier is None else earlier.scene.next_id
    stage, needs = start_fit(clip, priors, config, progress, backdrop, first_id)
    lap("start")
    if state is not None:
        stage.restore(state)
    stage.run(checkpoint, key, progress)
    lap("photometric")
    result = finish_fit(clip, priors, stage, needs, seconds)
    if backdrop is not None:
        result = replace(result, static=backdrop.with_own(result.static))
    if earlier is not None and result.scaffold is not None:
        result = replace(result, scaffold=earlier.continued(result.scaffold))
    return result


def start_fit(
    clip: Clip,
    priors: Priors,
    config: FitConfig,
    progress: Progress = silent,
    backdrop: Backdrop | None = None,
    first_id: int = 0,
) -> tuple[PhotometricStage, list[Need]]:
    """Everything before the first photometric step, and what it decided: cameras, scaffold, first Gaussians.

    `backdrop`: Gaussians that are there already and stay as they are; new ones get ids from `first_id`.
    """
    assert priors.cameras is not None
    rig = CameraRig(priors.cameras)
    drawn = None if backdrop is None else backdrop.drawn
    degree = 0 if drawn is None else degree_of(drawn.sh.shape[1])
    share = moving_share(priors)
    scaffold: Scaffold | None = None
    needs: list[Need] = []
    if share >= config.moving_share:
        start = start_scaffold(priors, config, progress)
        scaffold, needs, priors = start.scaffold, start.needs, start.priors
    if scaffold is None:
        still = share < config.moving_share
        why = f"{share:.3%} of the pixels move by themselves" if still else "too few moving tracks are long enough"
        needs.append(
            Need("motion", "none: no scaffold, no dynamic Gaussians", why, "the whole dynamic set and its stage")
        )
    spawner = _Spawner(clip, priors, config, degree, progress)
    static = spawner.static(scaffold is not None, backdrop, first_id)
    if len(static) == 0 and scaffold is not None and backdrop is None:  # everything moves: a backdrop from what moves
        static = spawner.static(False, backdrop, first_id)
    if len(static) == 0 and backdrop is None:
        raise F4xError(f"{clip.source}: no pixel has a usable depth; supply depth with --prior depth=FOLDER.")
    how = config.scaffold.kernel, config.native_threads
    next_id = first_id + len(static)
    if scaffold is None:
        model = SceneModel(static, None, None, rig, *how, drawn)
        return PhotometricStage(model, clip, priors, config, next_id), needs
    nodes = NodeSet(scaffold, config.scaffold.graph)
    dynamic = spawner.dynamic(SceneModel(static, None, nodes, rig, *how), next_id)
    model = SceneModel(static, dynamic, nodes, rig, *how, drawn)
    return PhotometricStage(model, clip, priors, config, next_id + len(dynamic)), needs


def finish_fit(
    clip: Clip, priors: Priors, stage: PhotometricStage, needs: list[Need], seconds: dict[str, float]
) -> FitResult:
    """What a stage has learnt, with its provenance."""
    config = stage.config
    needs = [_colour_need(stage), *needs, _gaussian_need(stage, config)]
    # Wall times stay out of the scene: the same clip, settings and seed give the same file.
    unsaid = ("key", "seconds")
    provenance = {
        "feature4x": __version__,
        "source": clip.source,
        "frames": clip.picked,
        "width": clip.width,
        "config": resolved(config),
        "priors": {n: {k: v for k, v in entry.items() if k not in unsaid} for n, entry in priors.provenance.items()},
        "backend": choose_backend(config.backend, stage.model.static.parameters["xyz"]),
    }
    return _result(clip, stage, needs, priors, provenance, seconds)


def require_enough(clip: Clip) -> None:
    """Raise F4xError when the clip has too few supervised frames or too small pictures for any fit."""
    if len(clip.supervised) < LEAST_FRAMES:
        raise F4xError(
            f"{clip.source}: {len(clip.supervised)} frames are too few to tell motion from parallax; give at least"
            f" {LEAST_FRAMES}."
        )
    if min(clip.width, clip.height) < LEAST_SIDE:
        raise F4xError(
            f"{clip.source}: pictures of {clip.width}x{clip.height} are too small; give at least"
            f" {LEAST_SIDE}x{LEAST_SIDE} pixels."
        )


def _spawn_frames(priors: Priors, config: FitConfig) -> np.ndarray:
    """Indices into F of the frames from which the static set is spawned."""
    count = min(config.spawn_static.frames, len(priors.frames))
    return np.unique(np.linspace(0, len(priors.frames) - 1, count).round().astype(int))


@dataclass(frozen=True)
class _Spawner:
    """The first Gaussians of a fit: as many as the clip shows, or all of it more thinly where there is no room."""

    clip: Clip
    priors: Priors
    config: FitConfig
    degree: int
    progress: Progress

    def static(self, moving: bool, backdrop: Backdrop | None, first_id: int) -> StaticGaussians:
        """What stands still, seen from frames all over the clip; outside what moves where there is such a thing."""
        chosen = _spawn_frames(self.priors, self.config)

        def cover_all(spawn: SpawnConfig) -> Spawned:
            rng, parts = np.random.default_rng(self.config.seed), [Spawned.joined([])]
            for done, which in enumerate(coarse_to_fine(len(chosen))):
                self.progress("spawn", done, len(chosen), "static")
                frame = int(chosen[which])
                valid = self._valid(frame)
                if moving and self.priors.mask is not None:
                    valid &= ~binary_dilation(self.priors.mask[frame], iterations=MASK_MARGIN)
                if backdrop is not None:
                    valid &= ~backdrop.explained[frame]
                parts = [Spawned.joined(parts), self._cover(frame, valid, Spawned.joined(parts).xyz, spawn, rng)]
            return Spawned.joined(parts)

        spawned, spawn = spawn_that_fits(cover_all, self.config.spawn_static)
        self.progress("spawn", len(chosen), len(chosen), "static")
        return spawn_static(spawned, self.degree, spawn, first_id)

    def dynamic(self, model: SceneModel, first_id: int) -> DynamicGaussians:
        """What moves, fused over time: every visited frame adds what those of earlier visited frames, moved there, leave open.

        `model` has the static Gaussians, the nodes and the cameras.
        """
        assert self.priors.mask is not None and model.nodes is not None
        with_motion = np.flatnonzero(self.priors.mask.reshape(len(self.priors.mask), -1).any(1))
        count = min(self.config.spawn_dynamic.frames, len(with_motion))
        chosen = with_motion[np.unique(np.linspace(0, len(with_motion) - 1, count).round().astype(int))]

        def cover_all(spawn: SpawnConfig) -> DynamicGaussians:
            rng, parts = np.random.default_rng(self.config.seed), []
            references: list[np.ndarray] = []
            dynamic: DynamicGaussians | None = None
            for done, which in enumerate(coarse_to_fine(len(chosen))):
                self.progress("spawn", done, len(chosen), "dynamic")
                frame = int(chosen[which])
                existing = self._moved(model, dynamic, frame)
                valid = self._valid(frame) & self.priors.mask[frame]  # type: ignore[index]
                parts.append(self._cover(frame, valid, existing, spawn, rng))
                references.append(np.full(len(parts[-1].xyz), frame))
                dynamic = self._carried(model, Spawned.joined(parts), np.concatenate(references), spawn, first_id)
            assert dynamic is not None
            return dynamic

        dynamic, _ = spawn_that_fits(cover_all, self.config.spawn_dynamic)
        self.progress("spawn", len(chosen), len(chosen), "dynamic")
        return dynamic

    def _valid(self, frame: int) -> np.ndarray:
        """(H,W) bool: pixels with a depth."""
        assert self.priors.depth is not None
        depth = self.priors.depth[frame]
        return np.isfinite(depth) & (depth > 0)

    def _cover(
        self, frame: int, valid: np.ndarray, existing: np.ndarray, spawn: SpawnConfig, rng: np.random.Generator
    ) -> Spawned:
        """Gaussians for what `existing` leaves open in supervised frame `frame`."""
        priors = self.priors
        assert priors.depth is not None and priors.cameras is not None
        picture = self.clip.frames[priors.frames[frame]]
        tolerance = None
        if priors.depth_confidence is not None:
            sure = np.maximum(priors.depth_confidence[frame].astype(np.float32), 0.01)
            tolerance = np.clip(2 * np.sqrt((1 - sure) / sure) * SURE_DEPTH, spawn.depth_tolerance, LOOSEST_DEPTH)
        return cover(picture, priors.depth[frame], valid, priors.cameras[frame], existing, spawn, rng, tolerance)

    def _carried(
        self, model: SceneModel, spawned: Spawned, reference: np.ndarray, spawn: SpawnConfig, first_id: int
    ) -> DynamicGaussians:
        """Spawned Gaussians attached to the model's nodes, each at its `reference` frame."""
        assert model.nodes is not None
        xyz, quat = model.nodes.parameters["node_xyz"].detach(), model.nodes.quat.detach()
        neighbours = model.nodes.neighbours.shape[1]
        return spawn_dynamic(spawned, reference, xyz, quat, neighbours, self.degree, spawn, first_id)

    def _moved(self, model: SceneModel, dynamic: DynamicGaussians | None, frame: int) -> np.ndarray:
        """(N,3) places of the dynamic Gaussians so far at supervised frame `frame`."""
        if dynamic is None or not len(dynamic):
            return np.zeros((0, 3), np.float32)
        with torch.no_grad():
            whole = SceneModel(model.static, dynamic, model.nodes, model.rig, model.kernel, model.threads)
            return whole.dynamic_at(float(model.times[frame]))[0][0].numpy()


def _colour_need(stage: PhotometricStage) -> Need:
    config = stage.config
    degree = degree_of(stage.model.static.sh.shape[1])
    if config.sh_degree is not None:
        return Need("view-dependent colour", f"degree {degree}", "set by hand", "-")
    gains = ", ".join(f"degree {d}: {gain:+.2f} dB" for d, gain in enumerate(stage.band_gains, 1))
    most = (config.most_sh_degree + 1) ** 2
    return Need(
        "view-dependent colour",
        f"degree {degree}",
        f"{gains} on left-out pictures in mid-fit; wanted {GAIN_DB}" if gains else "no higher one is allowed",
        f"{most - (degree + 1) ** 2} of {most} coefficients per Gaussian and colour",
    )


def _gaussian_need(stage: PhotometricStage, config: FitConfig) -> Need:
    model = stage.model
    static, dynamic = len(model.static), len(model.dynamic) if model.dynamic is not None else 0
    cap = sum(control.limit for control in stage.controls.values())
    curve = [point["psnr"] for point in stage.history[-2:]]
    rooms = {"static": config.spawn_static.max_count, "dynamic": config.spawn_dynamic.max_count}
    tight = [name for name, count in stage.spawned.items() if count > 0.9 * rooms[name]]
    bound = f" (no room for all that is {' or '.join(tight)}: the whole clip is covered more thinly)" if tight else ""
    gain = f", last {config.measure_every} steps brought {curve[1] - curve[0]:+.2f} dB" if len(curve) == 2 else ""
    return Need(
        "Gaussians",
        f"{static:,} static, {dynamic:,} dynamic",
        f"uncovered cells at the start{bound}, then screen-space gradients{gain}",
        f"{max(cap - static - dynamic, 0):,} of at most {cap:,}",
    )


def _result(
    clip: Clip,
    stage: PhotometricStage,
    needs: list[Need],
    priors: Priors,
    provenance: dict[str, Any],
    seconds: dict[str, float],
) -> FitResult:
    """The trained model as arrays of the scene file's layout."""
    model = stage.model
    with torch.no_grad():
        placed = model.static.parameters["xyz"], quaternion.normalize(model.static.parameters["quat"])
        static = _arrays(model.static, *placed)
        dynamic, scaffold = None, None
        if model.dynamic is not None and model.nodes is not None:
            scaffold = model.nodes.snapshot()
            x, q = model.dynamic.at_reference(model.nodes.parameters["node_xyz"], model.nodes.quat)
            weights, strength = model.skinning(x)
            dynamic = _arrays(model.dynamic, x, quaternion.normalize(q)) | {
                "reference": model.dynamic.labels["reference"].numpy().astype(np.int32),
                "node": model.nodes.neighbours[model.dynamic.labels["attach"]].numpy().astype(np.int32),
                "weight": weights.numpy().astype(np.float32),
                "strength": strength.numpy().astype(np.float32),
            }
    refined = model.rig.refined()
    return FitResult(
        static,
        dynamic,
        scaffold,
        refined.at_times(clip.times),
        needs,
        priors,
        stage.history,
        provenance,
        stage.next_id,
        seconds,
    )


def _arrays(gaussians: StaticGaussians | DynamicGaussians, x: torch.Tensor, q: torch.Tensor) -> dict[str, np.ndarray]:
    return {
        "ids": gaussians.labels["ids"].numpy().copy(),
        "xyz": x.numpy().copy(),
        "rotation": q.numpy().copy(),
        "scale": gaussians.scale.numpy().copy(),
        "opacity": gaussians.opacity.numpy().copy(),
        "sh": gaussians.sh.numpy().copy(),
    }
