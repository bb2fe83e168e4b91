"""Fits a clip: priors, needs, scaffold, spawning, training; an interrupted fit can be resumed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..clip import Clip
from ..errors import F4xError
from ..gaussians import StaticGaussians, learnt_before
from ..gaussians.camera_rig import CameraRig
from ..geometry import quaternion
from ..geometry.spherical_harmonics import degree_of
from ..geometry.splats import Splats
from ..metrics.believed import believed_degrees, depth_evidence
from ..native.kernels import torch_threads
from ..parallel import side_by_side
from ..priors import Priors, build_priors
from ..priors.config import config_hash
from ..priors.sizes import moving_masks
from ..progress import Progress, silent
from ..raster import choose_backend
from ..reading import undamaged
from ..scaffold import Scaffold
from ..scene import DynamicSet, Scene, StaticSet
from ..versions import VERSION
from .checkpoint import load_checkpoint
from .config import SETTINGS, FitConfig, for_motion, resolved
from .covered import completed
from .harmonics import GAIN_DB
from .model import NodeSet, SceneModel
from .needs import Need, Shortage, lack_in_words, moving_fraction
from .people import with_people_of
from .schedule import steps_at
from .spawning import Explained, Spawner
from .start import start_scaffold
from .tints import tinted_scene
from .trainer import FitStart, Trainer

CHECKPOINT = Path("checkpoints", "photometric.pt")
"""File in the folder of a fit from which it goes on."""
NOT_DECIDING = ("checkpoint_every", "counts_from", "own_counts", "measure_every")
"""Settings that do not change what a fit finds."""


@dataclass(frozen=True)
class FitResult:
    """A fitted scene, and how it came about."""

    scene: Scene
    priors: Priors
    """The priors it was fitted to."""
    history: list[dict[str, float]]
    """Quality curve of the training."""
    seconds: dict[str, float]
    """Wall time per stage of this call."""
    shortages: tuple[Shortage, ...] = ()
    """The sets of which less was allowed than the clip asked for."""
    moving: dict[int, np.ndarray] | None = None
    """Clip frame -> (H,W) bool of moving pixels by the priors, at the size of the pictures; None where there are no masks."""


def fit_clip(
    clip: Clip, folder: Path, config: FitConfig, progress: Progress = silent, resume: bool = False
) -> FitResult:
    """Fit `clip`, keeping priors and checkpoints in `folder`.

    Raises:
        F4xError: a clip that its `require_enough` refuses, unusable priors, or a checkpoint that does not belong to this clip
            and these settings.
    """
    return ClipFit(clip, folder, config, progress, resume).run()


@dataclass
class ClipFit:
    """The stages of one fit. A fit that goes on from an earlier scene overrides them (`previous_window`)."""

    clip: Clip
    folder: Path
    """For priors and checkpoints."""
    config: FitConfig
    progress: Progress = silent
    resume: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time of the stages that are done."""
    whole: bool = True
    """False for a window of a longer clip. A whole one gets its hidden background (`completed`) and `tinted_scene`."""

    def run(self) -> FitResult:
        """Run all stages, one after the other."""
        # Torch's sums depend on its number of threads. They also gain nothing beside those of the raster and collapse when
        # other work wants the cores.
        with torch_threads(1):
            return self._run()

    def _run(self) -> FitResult:
        self.clip.require_enough()
        checkpoint, settings_hash = self.folder / CHECKPOINT, self.settings_hash()
        if self.resume:
            load_checkpoint(checkpoint, settings_hash)  # what cannot be continued is refused before minutes of priors
        clock = time.perf_counter()
        priors = self.make_priors()
        clock = self._record("priors", clock)
        settings_hash += config_hash({name: entry.get("digest") for name, entry in priors.provenance.items()})
        state = load_checkpoint(checkpoint, settings_hash) if self.resume else None
        with side_by_side(self.config.kernels.threads):
            trainer = self.start(priors)
        clock = self._record("start", clock)
        if state is not None:
            with undamaged(checkpoint, "delete it and fit again without --resume"):
                trainer.restore(state)
        trainer.run(checkpoint, settings_hash, self.progress)
        self._record("photometric", clock)
        result = self.finish(trainer)
        scene = with_people_of(completed(result.scene) if self.whole else result.scene, priors)
        moving = moving_masks(priors, self.clip.width, self.clip.height)
        if self.whole:
            clock = time.perf_counter()
            with side_by_side(self.config.kernels.threads):
                scene = tinted_scene(scene, self.clip, self.config.tints, moving, self.config.backend, self.progress)
            self._record("colors over time", clock)
        known = {**scene.provenance, "believed_degrees": _believed(priors)}
        return replace(result, priors=priors, scene=replace(scene, provenance=known), moving=moving)

    def _record(self, stage: str, since: float) -> float:
        """Note the seconds of a stage; returns the time now."""
        now = time.perf_counter()
        self.seconds[stage] = round(now - since, 2)
        return now

    def settings_hash(self) -> str:
        """Return the hash of everything but the priors that decides what this fit finds."""
        settings = {name: value for name, value in resolved(self.config).items() if name not in NOT_DECIDING}
        return config_hash(settings, self.clip.digest, self.clip.width, self.clip.height)

    def known_depth(self) -> np.ndarray | None:
        """Return (F,H,W) depth known from elsewhere, NaN where it is not: a witness of which way round the priors are."""
        return None

    def make_priors(self) -> Priors:
        """Return the priors of the clip."""
        config, known_depth = self.config.priors_in_threads, self.known_depth()
        return build_priors(self.clip, self.folder / "priors", config, self.progress, known_depth)

    def start(self, priors: Priors) -> Trainer:
        """Return the trainer before its first step."""
        return start_fit(self.clip, priors, self.config, self.progress)

    def finish(self, trainer: Trainer) -> FitResult:
        """Return the scene of the trained model."""
        return finish_fit(trainer, self.seconds)


@dataclass(frozen=True, eq=False)
class KnownGround:
    """Static Gaussians that are known before a fit, from the previous window."""

    frozen: Splats
    """Tensors of those that are drawn and never change."""
    learning: Splats
    """Tensors of those that are learnt further, as new Gaussians."""
    explained: Explained
    """Pixels that they show rightly, which need no new Gaussian."""
    next_id: int
    """First id that no Gaussian has."""

    def gaussians(self, centre: np.ndarray, first_id: int) -> StaticGaussians:
        """Return the static Gaussians to learn further, seen from about `centre (3,)`, with ids from `first_id` on."""
        reach = (self.learning.means - torch.from_numpy(centre).float()).norm(dim=1)
        return learnt_before(self.learning, reach, first_id)


def start_fit(
    clip: Clip,
    priors: Priors,
    config: FitConfig,
    progress: Progress = silent,
    ground: KnownGround | None = None,
) -> Trainer:
    """Return everything before the first step: cameras, scaffold, first Gaussians. `ground`: what is known of the static scene."""
    assert priors.cameras is not None
    config = for_motion(config, moving_fraction(priors), len(priors.frames))
    rig = CameraRig(priors.cameras.resized(clip.width, clip.height))
    degree = 0 if ground is None else degree_of(ground.frozen.sh.shape[1])
    scaffold, needs, priors = _start_motion(priors, config, progress)
    spawner = Spawner(clip, priors, config, degree, progress)
    explained, first_id = (None, 0) if ground is None else (ground.explained, ground.next_id)
    static = spawner.static(scaffold is not None, explained, first_id)
    if len(static) == 0 and scaffold is not None and ground is None:  # all moves: a background from the movers
        static = spawner.static(False, explained, first_id)
    if len(static) == 0 and ground is None:
        raise F4xError(f"{clip.source}: no pixel has a usable depth; supply depth with --prior depth=FOLDER.")
    if ground is not None and len(ground.learning.means):
        static = static.followed_by(ground.gaussians(rig.path.centers.mean(0), first_id + len(static)))
    next_id, dynamic, nodes = first_id + len(static), None, None
    if scaffold is not None:
        nodes = NodeSet(scaffold, config.scaffold.graph)
        bare = SceneModel(static, None, nodes, rig, config.scaffold.kernel, config.kernels)
        dynamic = spawner.dynamic(bare, next_id)
        next_id += len(dynamic)
    frozen = None if ground is None else ground.frozen
    model = SceneModel(static, dynamic, nodes, rig, config.scaffold.kernel, config.kernels, frozen)
    return Trainer(model, clip, priors, config, FitStart(next_id, needs, spawner.rooms))


def _start_motion(priors: Priors, config: FitConfig, progress: Progress) -> tuple[Scaffold | None, list[Need], Priors]:
    """Return the scaffold, or None where nothing moves; what decided; the priors with depth that lies on the scaffold."""
    fraction = moving_fraction(priors)
    if fraction >= config.min_moving_fraction:
        start = start_scaffold(priors, config, progress)
        if start.scaffold is not None:
            return start.scaffold, start.needs, start.priors
        why = "too few moving tracks are long enough"
    else:
        why = f"{fraction:.3%} of the pixels move by themselves"
    need = Need("motion", "none: no scaffold, no dynamic Gaussians", why, "the whole dynamic set and its stage")
    return None, [need], priors


def finish_fit(trainer: Trainer, seconds: dict[str, float] | None = None) -> FitResult:
    """Return the scene that a trainer has learnt, with its provenance. `seconds`: wall time per stage."""
    clip, model = trainer.clip, trainer.model
    needs = [
        *_picture_need(clip),
        _colour_need(trainer),
        *trainer.needs,
        _gaussian_need(trainer),
        *_steps_need(trainer),
    ]
    scene = Scene(
        name=clip.name,
        static=_static_set(model),
        dynamic=DynamicSet.empty() if model.dynamic is None else _dynamic_set(model),
        scaffold=None if model.dynamic is None or model.nodes is None else model.nodes.snapshot(),
        cameras=model.rig.refined().at_times(clip.times),
        fps=clip.fps,
        held_out=tuple(int(i) for i in clip.held_out.nonzero()[0]),
        provenance=_provenance(trainer),
        needs=tuple(need.row() for need in needs),
        next_id=trainer.next_id,
    )
    return FitResult(scene, trainer.priors, trainer.history, seconds or {}, tuple(_shortages(trainer)))


def _picture_need(clip: Clip) -> list[Need]:
    if clip.picture is None:
        return []
    return [
        Need(
            "picture", f"{clip.picture} pixels", "the rest is black in the whole source", "bars that go with the camera"
        )
    ]


def _provenance(trainer: Trainer) -> dict[str, Any]:
    """Return the scene's provenance: clip, settings and providers.

    Wall times stay out of the scene: the same clip, settings and seed give the same file.
    """
    clip, config = trainer.clip, trainer.config
    left_out = ("key", "seconds", "previous")  # what depends on the machine, or on how often the fit was begun
    priors = trainer.priors.provenance
    return {
        "feature4x": VERSION,
        "source": clip.source,
        "frames": clip.picked,
        **({} if clip.picture is None else {"picture": asdict(clip.picture)}),
        **({"reading": [str(remark) for remark in clip.remarks]} if clip.remarks else {}),
        "width": clip.width,
        "config": resolved(config),
        "priors": {n: {k: v for k, v in entry.items() if k not in left_out} for n, entry in priors.items()},
        "backend": choose_backend(config.backend, trainer.model.static.parameters["means"]),
    }


def _believed(priors: Priors) -> float | None:
    """Return the degrees off the path within which all of the scene can be believed, to a tenth; None where nothing tells."""
    evidence = depth_evidence(priors)
    if evidence is None:
        return None
    believed = believed_degrees(evidence)
    return round(believed.static if believed.moving is None else min(believed.static, believed.moving), 1)


def _colour_need(trainer: Trainer) -> Need:
    config = trainer.config
    degree = degree_of(trainer.model.static.sh.shape[1])
    if config.sh_degree is not None:
        return Need("view-dependent colour", f"degree {degree}", "set by hand", "-")
    gains = ", ".join(f"degree {d}: {gain:+.2f} dB" for d, gain in enumerate(trainer.band_gains, 1))
    max_coefficients = (config.max_sh_degree + 1) ** 2
    return Need(
        "view-dependent colour",
        f"degree {degree}",
        f"{gains} on left-out pictures in mid-fit; wanted {GAIN_DB}" if gains else "no higher one is allowed",
        f"{max_coefficients - (degree + 1) ** 2} of {max_coefficients} coefficients per Gaussian and colour",
    )


def _shortages(trainer: Trainer) -> Iterator[Shortage]:
    """Yield the sets of which less was allowed than the clip asked for."""
    config = trainer.config
    for name, room in trainer.rooms.items():
        lacking = trainer.controls[name].lacking
        if room.short or lacking:
            setting = config.first_limit_of(name) if room.short else f"density_{name}.max_count"
            by_hand = config.counts_from == SETTINGS or setting in config.own_counts
            yield Shortage(name, room, lacking, setting if by_hand else config.counts_from)


def _gaussian_need(trainer: Trainer) -> Need:
    model, config = trainer.model, trainer.config
    static, dynamic = len(model.static), len(model) - len(model.static)
    cap = sum(control.limit for control in trainer.controls.values())
    curve = [point["psnr"] for point in trainer.history[-2:]]
    asked = " and ".join(f"{room.asked:,} {name}" for name, room in trainer.rooms.items())
    gain = f", last {config.measure_every} steps brought {curve[1] - curve[0]:+.2f} dB" if len(curve) == 2 else ""
    return Need(
        "Gaussians",
        "; ".join(filter(None, [f"{static:,} static, {dynamic:,} dynamic", lack_in_words(_shortages(trainer))])),
        f"uncovered cells at the start asked for {asked}, then screen-space gradients{gain}",
        f"{max(cap - static - dynamic, 0):,} of at most {cap:,}",
    )


def _steps_need(trainer: Trainer) -> list[Need]:
    """Return how many of the steps were done and why, where a fit may end early."""
    if not trainer.aside_psnr:
        return []
    ending, total, skipped = trainer.config.ending, trainer.config.steps, trainer.skipped
    after = sorted(steps_at(ending.at, total))
    measured = ", ".join(
        f"{value:.2f} dB after {step:,}" for step, value in zip(after, trainer.aside_psnr, strict=False)
    )
    why = f"{len(trainer.aside)} frames kept aside had {measured} steps; at least {ending.min_gain:+g} dB each time was wanted"
    early = "ended early, " if skipped else ""
    return [Need("steps", f"{early}{total - skipped:,} of {total:,}", why, f"{skipped:,} steps skipped")]


def _static_set(model: SceneModel) -> StaticSet:
    with torch.no_grad():
        own = model.static
        quats = quaternion.normalize(own.parameters["quats"])
        splats = own.splats(own.parameters["means"], quats).map(_numpy)
    return StaticSet(**splats.arrays(), ids=_numpy(own.labels["ids"]))


def _dynamic_set(model: SceneModel) -> DynamicSet:
    """Return the dynamic Gaussians, each at its own reference time."""
    own, nodes = model.dynamic, model.nodes
    assert own is not None and nodes is not None
    with torch.no_grad():
        x, q = own.at_reference(nodes.parameters["node_xyz"], nodes.quat)
        weights, strength = model.skinning(x)
        splats = own.splats(x, quaternion.normalize(q)).map(_numpy)
    return DynamicSet(
        **splats.arrays(),
        ids=_numpy(own.labels["ids"]),
        reference=_numpy(own.labels["reference"]).astype(np.int32),
        node=_numpy(nodes.neighbours[own.labels["attach"]]).astype(np.int32),
        weight=_numpy(weights).astype(np.float32),
        strength=_numpy(strength).astype(np.float32),
        span=_span(model),
    )


def _span(model: SceneModel) -> np.ndarray | None:
    """Return (N,4) float32: when dynamic Gaussians are there, beyond the clip for those whole at its ends; None: all always are."""
    assert model.dynamic is not None
    with torch.no_grad():
        span = _numpy(model.dynamic.spans(model.born)).astype(np.float32)
    span[span[:, 1] <= model.times[0], :2] = -np.inf
    span[span[:, 2] >= model.times[-1], 2:] = np.inf
    return span if np.isfinite(span).any() else None


def _numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().numpy().copy()
