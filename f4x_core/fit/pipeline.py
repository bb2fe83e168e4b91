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
from ..gaussians import DynamicGaussians, Spawned, StaticGaussians, spawn_dynamic, spawn_static
from ..gaussians.spawn import coarse_to_fine, cover
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
    priors = build_priors(clip, folder / "priors", config.priors, progress)
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
    rng = np.random.default_rng(config.seed)
    rig = CameraRig(priors.cameras)
    drawn = None if backdrop is None else backdrop.drawn
    degree = 0 if drawn is None else degree_of(drawn.sh.shape[1])
    share = moving_share(priors)
    scaffold: Scaffold | None = None
    needs: list[Need] = []
    if share >= config.moving_share:
        scaffold, needs = start_scaffold(priors, config, progress)
    if scaffold is None:
        still = share < config.moving_share
        why = f"{share:.3%} of the pixels move by themselves" if still else "too few moving tracks are long enough"
        needs.append(
            Need("motion", "none: no scaffold, no dynamic Gaussians", why, "the whole dynamic set and its stage")
        )
    told = backdrop, first_id, rng, progress
    static = _spawn_static(clip, priors, config, degree, scaffold is not None, *told)
    if len(static) == 0 and scaffold is not None and backdrop is None:  # everything moves: a backdrop from what moves
        static = _spawn_static(clip, priors, config, degree, False, *told)
    if len(static) == 0 and backdrop is None:
        raise F4xError(f"{clip.source}: no pixel has a usable depth; supply depth with --prior depth=FOLDER.")
    how = config.scaffold.kernel, config.native_threads
    next_id = first_id + len(static)
    if scaffold is None:
        model = SceneModel(static, None, None, rig, *how, drawn)
        return PhotometricStage(model, clip, priors, config, next_id), needs
    nodes = NodeSet(scaffold, config.scaffold.graph)
    dynamic = _spawn_dynamic(clip, priors, config, degree, static, nodes, rig, next_id, rng, progress)
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


def _spawn_static(
    clip: Clip,
    priors: Priors,
    config: FitConfig,
    degree: int,
    moving: bool,
    backdrop: Backdrop | None,
    first_id: int,
    rng: np.random.Generator,
    progress: Progress,
) -> StaticGaussians:
    spawn = config.spawn_static
    assert priors.depth is not None and priors.cameras is not None
    chosen = _spawn_frames(priors, config)
    parts: list[Spawned] = []
    existing = np.zeros((0, 3), np.float32)
    for done, which in enumerate(coarse_to_fine(len(chosen))):
        frame = int(chosen[which])
        progress("spawn", done, len(chosen), "static")
        depth = priors.depth[frame]
        valid = np.isfinite(depth) & (depth > 0)
        if moving and priors.mask is not None:
            valid &= ~binary_dilation(priors.mask[frame], iterations=MASK_MARGIN)
        if backdrop is not None:
            valid &= ~backdrop.explained[frame]
        image = clip.frames[priors.frames[frame]]
        part = cover(image, depth, valid, priors.cameras[frame], existing, spawn, rng)
        parts.append(part)
        existing = np.concatenate([existing, part.xyz])
        if len(existing) >= spawn.most:
            break
    progress("spawn", len(chosen), len(chosen), "static")
    return spawn_static(_joined(parts, spawn.most), degree, spawn, first_id)


def _spawn_dynamic(
    clip: Clip,
    priors: Priors,
    config: FitConfig,
    degree: int,
    static: StaticGaussians,
    nodes: NodeSet,
    rig: CameraRig,
    first_id: int,
    rng: np.random.Generator,
    progress: Progress,
) -> DynamicGaussians:
    """Fusion over time: every visited frame adds what the Gaussians of earlier visited frames, moved there, do not cover."""
    spawn = config.spawn_dynamic
    assert priors.depth is not None and priors.cameras is not None and priors.mask is not None
    with_motion = np.flatnonzero(priors.mask.reshape(len(priors.mask), -1).any(1))
    chosen = np.unique(
        with_motion[np.linspace(0, len(with_motion) - 1, min(spawn.frames, len(with_motion))).round().astype(int)]
    )
    node_xyz, node_quat = nodes.parameters["node_xyz"].detach(), nodes.quat.detach()
    neighbours = nodes.neighbours.shape[1]
    parts: list[Spawned] = []
    references: list[np.ndarray] = []
    dynamic: DynamicGaussians | None = None
    for done, which in enumerate(coarse_to_fine(len(chosen))):
        frame = int(chosen[which])
        progress("spawn", done, len(chosen), "dynamic")
        existing = np.zeros((0, 3), np.float32)
        if dynamic is not None and len(dynamic):
            with torch.no_grad():
                model = SceneModel(static, dynamic, nodes, rig, config.scaffold.kernel, config.native_threads)
                existing = model.dynamic_at(float(priors.cameras.times[frame]))[0][0].numpy()
        depth = priors.depth[frame]
        valid = np.isfinite(depth) & (depth > 0) & priors.mask[frame]
        part = cover(clip.frames[priors.frames[frame]], depth, valid, priors.cameras[frame], existing, spawn, rng)
        parts.append(part)
        references.append(np.full(len(part.xyz), frame))
        joined = _joined(parts, spawn.most)
        reference = np.concatenate(references)[: len(joined.xyz)]
        dynamic = spawn_dynamic(joined, reference, node_xyz, node_quat, neighbours, degree, spawn, first_id)
        if len(joined.xyz) >= spawn.most:
            break
    progress("spawn", len(chosen), len(chosen), "dynamic")
    assert dynamic is not None
    return dynamic


def _joined(parts: list[Spawned], most: int) -> Spawned:
    return Spawned(
        np.concatenate([part.xyz for part in parts])[:most],
        np.concatenate([part.rgb for part in parts])[:most],
        np.concatenate([part.radius for part in parts])[:most],
    )


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
    cap = config.density_static.most + config.density_dynamic.most
    curve = [point["psnr"] for point in stage.history[-2:]]
    gain = f", last {config.measure_every} steps brought {curve[1] - curve[0]:+.2f} dB" if len(curve) == 2 else ""
    return Need(
        "Gaussians",
        f"{static:,} static, {dynamic:,} dynamic",
        f"uncovered cells at the start, then screen-space gradients{gain}",
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
