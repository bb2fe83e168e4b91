"""Every setting of the fit, one documented field each, and the named profiles.

Lengths are in world units (median scene depth = 1), steps are optimiser steps, rates are Adam's.
"""

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ..errors import F4xError
from ..gaussians import DensityConfig, SpawnConfig
from ..native.kernels import Kernels
from ..priors import PriorsConfig, TracksConfig
from ..priors.config import USUAL_FRAMES
from ..raster import choose_backend
from ..scaffold.following import FollowingConfig
from ..scaffold.graph import GraphConfig
from ..scaffold.optimise import GeometryConfig
from ..scaffold.selection import Rotations, SelectionConfig
from ..scaffold.skinning import Kernel
from .tints import TintConfig

# Node counts that are tried, fewest first.
NODE_COUNTS = (4, 8, 16, 32, 64, 128, 192, 256, 384, 512)


@dataclass(frozen=True)
class ScaffoldConfig:
    """Initialisation of the motion scaffold from tracks."""

    tolerance: float = 1.0
    """Pixels within which 90 % of the held-out tracks must be carried; the fewest nodes that do so are taken."""
    tolerance_fraction: float = 0.005
    """The same as a fraction of the picture's width; the smaller of both holds. A pixel of a picture 96 wide is five of one
    480 wide. Chosen on toy worlds 96 wide, three seeds each: going on from a pixel to half a one gains 1.4 dB for an arm
    (8 to 32 nodes) and 3.3 dB for a flag (8 to 64); twice as many nodes then gain less than 0.3 dB. From 200 pixels on it
    is the whole pixel."""
    min_nodes: int = 4
    """Never fewer nodes than this."""
    max_nodes: int = 400
    """Never more nodes than this. `quick` with 400 in place of 150: +.4 dB on breakdance's dancer, whom no residual of fewer
    nodes comes near, for a twelfth more time."""
    neighbours: int = 8
    """Nodes (itself included) that a Gaussian follows."""
    kernel: Kernel = "sigma"
    """Skinning kernel: `sigma` exp(-d^2/2s^2) (MoSca code) or `paper` exp(-d^2/2r) (Eq. 1)."""
    distance_rank: int = 1
    """k: the distance of two nodes is the k-th largest over time. 1 is the maximum (Feature4X), more forgives bad frames."""
    rotations: Rotations = "tracks"
    """Nodes start turned as the `tracks` around them turn (MoSca's code), or all upright (`identity`, Feature4X)."""
    geometry_steps: int = 300
    """Steps of the geometric optimisation."""
    geometry_arap: float = 1.0
    """Weight of the as-rigid-as-possible losses in the geometric optimisation."""
    following_steps: int = 300
    """Steps in which nodes learn to carry all tracks of what moves, not only those that became nodes."""

    @property
    def graph(self) -> GraphConfig:
        """The node graph of every stage."""
        return GraphConfig(neighbours=self.neighbours, kth=self.distance_rank)

    def tolerance_at(self, width: int) -> float:
        """Return the pixels within which nodes must carry tracks in a picture `width` pixels wide."""
        return min(self.tolerance, self.tolerance_fraction * width)

    def selection(self, seed: int) -> SelectionConfig:
        """Return the selection of nodes from tracks."""
        between = tuple(count for count in NODE_COUNTS if self.min_nodes <= count <= self.max_nodes)
        return SelectionConfig(
            counts=between or (self.max_nodes,),
            maximum=self.max_nodes,
            rotations=self.rotations,
            seed=seed,
            graph=self.graph,
        )

    def geometry(self, seed: int) -> GeometryConfig:
        """Return the geometric optimisation."""
        weight = self.geometry_arap
        return GeometryConfig(steps=self.geometry_steps, coordinate=weight, length=weight, seed=seed, graph=self.graph)

    def following(self, seed: int) -> FollowingConfig:
        """Return the settings by which nodes follow the tracks."""
        return FollowingConfig(steps=self.following_steps, seed=seed, geometry=self.geometry(seed), kernel=self.kernel)


@dataclass(frozen=True)
class NodeConfig:
    """Schedule of adding and removing nodes in the photometric stage."""

    add_at: tuple[float, ...] = (0.3, 0.42)
    """Fractions of the steps at which badly carried Gaussians become nodes."""
    growth: float = 0.2
    """At most this fraction of the nodes is added each time."""
    max_nodes: int = 600
    """Never more nodes than this."""
    drop_at: tuple[float, ...] = (0.47,)
    """Fractions of the steps at which useless nodes are removed."""
    prune_weight: float = 0.02
    """A node without attached Gaussians whose largest skinning weight is below this is useless."""


Rate = tuple[float, float]
"""Adam's learning rate at the start and at the end of a fit, log-linear between them."""


@dataclass(frozen=True)
class GaussianRates:
    """Learning rates of one set of Gaussians.

    A short fit begins with rates at which a picture is about right after each Gaussian was seen some dozen times, and ends with
    rates at which the last frames seen no longer shake it. Against rates five times smaller that stay, `quick` gains 1 dB on
    frames held out of car-shadow and .4 dB of train, nothing of camel; still larger rates of dynamic Gaussians lose .3 dB of train.
    """

    means: Rate
    """Places, at depth 1."""
    quats: Rate
    """Orientations."""
    log_scales: Rate
    """Sizes."""
    opacity_logits: Rate
    """Opacities."""
    sh0: Rate
    """Colours."""
    shN: Rate = (5e-4, 5e-4)  # noqa: N815 - gsplat's name
    """View-dependent colours."""


@dataclass(frozen=True)
class RateConfig:
    """Adam's learning rates."""

    static: GaussianRates = field(
        default_factory=lambda: GaussianRates(
            means=(6e-4, 6e-6),
            quats=(0.015, 7.5e-4),
            log_scales=(0.05, 2.5e-3),
            opacity_logits=(0.2, 0.01),
            sh0=(0.03, 1.5e-3),
        )
    )
    """Static Gaussians."""
    dynamic: GaussianRates = field(
        default_factory=lambda: GaussianRates(
            means=(6e-4, 6e-6),
            quats=(4e-3, 4e-3),
            log_scales=(0.02, 0.02),
            opacity_logits=(0.1, 0.1),
            sh0=(0.01, 0.01),
        )
    )
    """Dynamic Gaussians: their appearance is learnt to the end, as their motion is."""
    dw: float = 5e-3
    """Skinning offsets of Eq. 1."""
    lifetimes: float = 5e-3
    """Logarithms of the times that moving Gaussians are there; 0: all are there always, as in the papers."""
    node_xyz: Rate = (2.5e-4, 5e-6)
    """Node positions."""
    node_quat: Rate = (5e-4, 1e-5)
    """Node orientations."""
    radius: float = 3e-3
    """Logarithm of the node radii."""
    camera_rotation: Rate = (3e-5, 3e-6)
    """Camera orientation (radians). The priors' cameras meet the tracks within a third of a pixel; colours, which hands that shake
    blur, know little better: three times this rate loses .7 dB on moving objects of dog, none at all .4 dB on the background."""
    camera_position: Rate = (3e-5, 3e-6)
    """Camera position."""

    def of(self, kind: str, tensor: str) -> Rate | float:
        """Return the rate of a parameter `tensor` of the Gaussians that are `kind`, `static` or `dynamic`."""
        own: GaussianRates = getattr(self, kind)
        if tensor == "dw":
            return self.dw
        if tensor == "log_lifetimes":
            return self.lifetimes
        return getattr(own, tensor.removeprefix("local_"))


@dataclass(frozen=True)
class LossConfig:
    """Weights of the losses; 0 switches one off."""

    ssim: float = 0.3
    """1 - SSIM beside the L1 of the picture, which is summed over channels."""
    moving: float = 3.0
    """Weight of a moving pixel in the picture losses; a static one has 1. Moving objects are small but looked at."""
    depth: float = 0.3
    """Confidence-weighted inverse depth. A sixth of this gives no better pictures of camel, whose world is almost flat, but two of
    six pairs of its pixels in the wrong order."""
    roughness: float = 1.0
    """Bends of the inverse depth where the pictures are plain and the prior unsure. Without this the asphalt before car-shadow's
    car frays as soon as it is seen from the side; three times as much takes .3 dB from its pictures, this nothing."""
    mask: float = 0.05
    """Alpha of the dynamic Gaussians against the moving mask, where the motion score is certain."""
    arap_coordinate: float = 0.3
    """As-rigid-as-possible: neighbours keep their place in a node's frame."""
    arap_length: float = 0.3
    """As-rigid-as-possible: neighbours keep their distance."""
    velocity: float = 0.03
    """Node speed."""
    acceleration: float = 0.3
    """Change of node velocity."""
    rotation_velocity: float = 0.01
    """Node angular speed."""
    rotation_acceleration: float = 0.1
    """Change of node angular speed."""
    dw: float = 0.01
    """Size of the skinning offsets."""
    track: float = 0.02
    """Pixel distance of rendered correspondences from the tracks."""
    camera_smoothness: float = 1.0
    """Squared second differences of the corrections to the camera path, per pixel of image motion."""


@dataclass(frozen=True)
class EndingConfig:
    """Early end of a fit, once frames that it has not drawn yet gain no more."""

    min_gain: float = 0.0
    """Least gain of those frames between two moments (dB); a fit that gains less skips steps. 0 = every step is done: while rates
    fall, car-shadow and dog gain .2 dB and more with every tenth of `wild`."""
    at: tuple[float, ...] = (0.3, 0.4, 0.5, 0.6, 0.7)
    """Moments at which they are measured, as fractions of the steps. They are drawn from the last one on, or once steps are
    skipped."""
    goes_on_at: float = 0.8
    """Fraction of the steps at which a fit goes on that gains no more: rates have to fall, and those frames have to be drawn."""
    frames: int = 4
    """Frames kept aside, evenly over the clip; clips of fewer than eight times as many used frames keep none aside."""


SETTINGS = "settings"
"""`FitConfig.counts_from` where nobody granted memory or minutes."""
LARGE_MOTION, MAX_MOVING = 0.25, 0.5
"""Fraction of the pictures from which moving objects are large, as a thing held before the camera, and the largest fraction of all
Gaussians that dynamic ones get then. Of the twelve real clips the masks cover at most .2."""
FIRST_FRACTION = 0.8
"""Fraction of a set's largest number of Gaussians that it may begin with: the rest is for what turns out to be wrong."""


@dataclass(frozen=True)
class FitConfig:
    """One profile: everything `fit` decides by, saved resolved beside the result."""

    name: str = "wild"
    """Name of the profile."""
    counts_from: str = SETTINGS
    """Source of the largest numbers of Gaussians: the settings, or the grant that they were scaled to, for example --memory 2."""
    own_counts: tuple[str, ...] = ()
    """The largest numbers that were set by hand and that `counts_from` left as they were."""
    steps: int = 3600
    """Steps of the joint photometric stage, for clips of up to `USUAL_FRAMES` frames (`for_frames`). Half as many with a close-up
    each sharpen the horse of horsejump-high by 1 dB, and lose .5 and .7 dB of camel's and car-shadow's frames held out."""
    coarse: float = 0.1
    """Fraction of the steps done at half resolution."""
    closeups: int = 0
    """Steps of dynamic Gaussians and nodes alone after each of the others, each on the window around what moves in another
    frame. Of a fast mover a frame has few Gaussians of its own, and each frame is drawn a dozen times in a short fit. A second one
    in `quick` sharpens what moves in the given frames by 1 dB, brings nothing between them, and costs a third of the time."""
    priors: PriorsConfig = field(default_factory=PriorsConfig)
    """Providers of the priors."""
    scaffold: ScaffoldConfig = field(default_factory=ScaffoldConfig)
    """Motion scaffold."""
    nodes: NodeConfig = field(default_factory=NodeConfig)
    """Node control during the photometric stage."""
    spawn_static: SpawnConfig = field(default_factory=lambda: SpawnConfig(spacing=1.6, max_count=240_000))
    """Start of the static set."""
    spawn_dynamic: SpawnConfig = field(default_factory=lambda: SpawnConfig(spacing=1.5, max_count=60_000))
    """Start of the dynamic set."""
    density_static: DensityConfig = field(default_factory=lambda: DensityConfig(max_count=300_000))
    """Growth of the static set."""
    density_dynamic: DensityConfig = field(default_factory=lambda: DensityConfig(max_count=80_000, gradient=1e-4))
    """Growth of the dynamic set."""
    tints: TintConfig = field(default_factory=TintConfig)
    """Colors over time."""
    sh_degree: int | None = None
    """Degree of the spherical harmonics at the end; None = as the pictures ask for it, at most `max_sh_degree`."""
    max_sh_degree: int = 1
    """Upper limit when the pictures decide."""
    harmonics_at: tuple[float, float, float] = (0.4, 0.6, 0.8)
    """Fractions of the steps at which the pictures are asked for degree 1, 2, 3; every fit begins with plain colours."""
    min_moving_fraction: float = 3e-4
    """Clips whose moving region covers less than this fraction of all pixels get no scaffold and no dynamic set."""
    rates: RateConfig = field(default_factory=RateConfig)
    """Learning rates."""
    losses: LossConfig = field(default_factory=LossConfig)
    """Loss weights."""
    rate_decay_start: float = 0.1
    """Fraction of the steps after which the paired rates begin to decay."""
    cameras_from: float = 0.1
    """Fraction of the steps after which cameras are refined."""
    dw_from: float = 0.5
    """Fraction of the steps after which the graph is frozen and skinning offsets are learnt."""
    ending: EndingConfig = field(default_factory=EndingConfig)
    """Early end."""
    average_from: float = 0.85
    """Fraction of the steps from which on the Gaussians and nodes of moving objects are averaged: their rates do not fall."""
    graph_every: int = 100
    """Steps between two rebuilds of the node graph before it is frozen."""
    track_every: int = 4
    """Every n-th step carries the track loss."""
    rough_every: int = 2
    """Every n-th step carries the roughness of depth, n times as heavy."""
    motion_every: int = 2
    """Every n-th step carries the physics-inspired losses, n times as heavy."""
    shifts: tuple[int, ...] = (1, 3, 8)
    """Frame shifts of the as-rigid-as-possible losses."""
    shift_weights: tuple[float, ...] = (0.6, 0.2, 0.2)
    """Their weights."""
    random_background: bool = True
    """A random background colour per step keeps the picture opaque."""
    checkpoint_every: int = 250
    """Steps between two checkpoints."""
    measure_every: int = 250
    """Steps between two points of the quality curve on the diagnostics page."""
    seed: int = 0
    """Seed of everything random."""
    backend: Literal["auto", "native", "torch", "reference"] = "auto"
    """Raster backend; the tensors of a fit lie on the CPU."""
    threads: int | None = None
    """Threads of the compiled library, and of whatever is done side by side; None = all. They change no bit of a result."""

    def __post_init__(self) -> None:
        """Refuse fields that do not fit each other."""
        if len(self.shifts) != len(self.shift_weights) or not self.shifts:
            raise F4xError(
                f"shifts has {len(self.shifts)} numbers and shift_weights {len(self.shift_weights)}; give one weight for each"
                " shift, and at least one."
            )

    def start_of(self, kind: str) -> SpawnConfig:
        """Start of the set `kind`, `static` or `dynamic`, within the number of Gaussians that the set may grow to."""
        own = getattr(self, f"spawn_{kind}")
        return replace(own, max_count=max(1, min(own.max_count, self._first_of_growth(kind))))

    def first_limit_of(self, kind: str) -> str:
        """Return the name of the setting that the number of `start_of` comes from."""
        own = getattr(self, f"spawn_{kind}").max_count
        return f"{'spawn' if own <= self._first_of_growth(kind) else 'density'}_{kind}.max_count"

    def _first_of_growth(self, kind: str) -> int:
        """Return the Gaussians that a set may begin with by what it may grow to."""
        return int(FIRST_FRACTION * getattr(self, f"density_{kind}").max_count)

    @property
    def priors_in_threads(self) -> PriorsConfig:
        """`priors` with the threads of the fit, where they have none of their own."""
        return replace(self.priors, threads=self.priors.threads or self.threads)

    @property
    def kernels(self) -> Kernels:
        """Implementation of the inner loops."""
        return Kernels(choose_backend(self.backend) == "native", self.threads or os.cpu_count() or 1)


def _quick() -> FitConfig:
    return FitConfig(
        name="quick",
        steps=800,
        coarse=0.15,
        closeups=1,
        # Lifetimes that learn twice as fast show the given frames of a dancer no better, and lose .1 dB of those between
        # (breakdance).
        rates=RateConfig(lifetimes=0.0025),
        priors=PriorsConfig(tracks=TracksConfig(count=6000)),
        scaffold=ScaffoldConfig(geometry_steps=150),
        # Half as many static Gaussians to begin with as there will be: where one is missing is known after some steps, and few are
        # cheap. Begun with nearly all of them, blackswan is .4 dB worse after 600 steps, dog the same; of moving ones people-walk
        # wants all at once (10 degrees aside -.4 dB otherwise).
        spawn_static=SpawnConfig(spacing=2.3, max_count=160_000),
        spawn_dynamic=SpawnConfig(spacing=1.5, max_count=40_000),
        density_static=DensityConfig(max_count=200_000, every=120, growth=0.2, max_growth=2.2),
        density_dynamic=DensityConfig(max_count=50_000, every=200, gradient=1e-4),
        checkpoint_every=150,
        measure_every=150,
    )


def _nvidia() -> FitConfig:
    return FitConfig(
        name="nvidia",
        rates=RateConfig(lifetimes=0),
        steps=8000,
        max_sh_degree=3,
        shifts=(2, 4),
        shift_weights=(0.6, 0.4),
        losses=LossConfig(arap_coordinate=0.3, arap_length=0.3, track=0.005, depth=0.05, roughness=0),
        random_background=False,
    )


def _dycheck() -> FitConfig:
    return FitConfig(
        name="dycheck",
        rates=RateConfig(lifetimes=0),
        steps=8000,
        max_sh_degree=3,
        shifts=(1, 3, 6),
        shift_weights=(0.6, 0.3, 0.1),
        losses=LossConfig(arap_coordinate=10, arap_length=10, track=0.1, depth=0.1, roughness=0),
    )


def _f4x_davis() -> FitConfig:
    return FitConfig(
        name="f4x_davis",
        rates=RateConfig(lifetimes=0),
        steps=5000,
        shifts=(2, 4),
        shift_weights=(0.6, 0.4),
        losses=LossConfig(velocity=0, rotation_velocity=0, track=0.01, roughness=0),
        scaffold=ScaffoldConfig(neighbours=10, geometry_steps=900),
        random_background=False,
    )


PROFILES = {"wild": FitConfig, "quick": _quick, "nvidia": _nvidia, "dycheck": _dycheck, "f4x_davis": _f4x_davis}


def for_frames(config: FitConfig, frames: int) -> FitConfig:
    """The configuration for so many used `frames`: each beyond `USUAL_FRAMES` adds its part of the steps, and of the room for
    moving Gaussians, which come and go with what they show.

    Numbers that are no profile's were set by hand and stay.
    """
    if config.name not in PROFILES or frames <= USUAL_FRAMES:
        return config
    usual, factor = profile(config.name), frames / USUAL_FRAMES
    changes: dict[str, Any] = {}
    if config.steps == usual.steps:
        changes["steps"] = round(factor * config.steps)
    for name in ("spawn_dynamic", "density_dynamic"):
        own = getattr(config, name)
        if own.max_count == getattr(usual, name).max_count:
            changes[name] = replace(own, max_count=round(factor * own.max_count))
    return replace(config, **changes)


def for_motion(config: FitConfig, fraction: float, frames: int) -> FitConfig:
    """The configuration for so many used `frames` of which moving objects cover the `fraction`: where it is large, room for static
    Gaussians becomes room for moving ones, as many together as before.

    Numbers that were set by hand stay.
    """
    if config.name not in PROFILES or fraction <= LARGE_MOTION or config.own_counts:
        return config
    usual = for_frames(profile(config.name), frames)
    changes: dict[str, Any] = {}
    for stage in ("spawn", "density"):
        names = (f"{stage}_static", f"{stage}_dynamic")
        static, dynamic = (getattr(config, name) for name in names)
        if config.counts_from == SETTINGS and any(
            getattr(config, name).max_count != getattr(usual, name).max_count for name in names
        ):
            return config
        both = static.max_count + dynamic.max_count
        moving = max(dynamic.max_count, round(min(fraction, MAX_MOVING) * both))
        changes |= {
            names[0]: replace(static, max_count=both - moving),
            names[1]: replace(dynamic, max_count=moving),
        }
    return replace(config, **changes)


def profile(name: str) -> FitConfig:
    """Return the profile called `name`; raises F4xError for an unknown one."""
    if name not in PROFILES:
        raise F4xError(f"There is no profile '{name}'; the profiles are {', '.join(PROFILES)}.")
    return PROFILES[name]()


THREADS = "threads"
"""Name of the settings that spread work over cores and change no bit of a result."""


def resolved(config: FitConfig) -> dict:
    """Return the settings that a result can depend on, as plain JSON values, every default written out; without `THREADS`."""

    def plain(value: object) -> Any:
        if dataclasses.is_dataclass(value):
            names = (f.name for f in dataclasses.fields(value) if f.name != THREADS)
            return {name: plain(getattr(value, name)) for name in names}
        if isinstance(value, tuple):
            return [plain(item) for item in value]
        return dict(value) if isinstance(value, Mapping) else value

    return plain(config)
