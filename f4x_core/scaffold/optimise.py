"""Geometric optimisation: the graph fills in what the tracks did not see and settles the rotations."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch

from ..geometry import quaternion
from ..native.kernels import TORCH, Kernels
from ..progress import Progress, silent
from .adam import Adam
from .deformation import align_signs
from .distance import curve_distance
from .graph import GraphConfig, build_graph, multilevel_edges
from .losses import ArapEdges, MotionTerms, motion_loss
from .motion_native import MotionWeights
from .structure import Scaffold


@dataclass(frozen=True)
class GeometryConfig:
    """Settings of `optimise_geometry`. Losses are means over time and nodes."""

    steps: int = 300
    learning_rate: float = 0.01
    """Learning rate of node positions (world units) and rotations (quaternion components)."""
    decay_start: float = 1 / 3
    """Fraction of the steps after which the rate falls along a cosine ..."""
    decay_to: float = 1 / 30
    """... to this fraction of itself."""
    coordinate: float = 1.0
    """Weight of the ARAP coordinate loss."""
    length: float = 1.0
    """Weight of the ARAP length loss."""
    velocity: float = 0.1
    acceleration: float = 0.3
    angular_velocity: float = 0.05
    angular_acceleration: float = 0.1
    shifts: tuple[int, ...] = (1, 2, 4, 8)
    """Frame distances over which the local shape should stay."""
    shift_weights: tuple[float, ...] = (0.3, 0.3, 0.2, 0.2)
    certain: Literal["soft", "hard"] = "soft"
    """Observed positions are held by a spring (which lets the graph take out depth noise), or exactly."""
    certain_weight: float = 50.0
    """Stiffness of the spring, per squared world unit."""
    along_ray: float = 1 / 16
    """Stiffness along the ray against across it where depth is a mere guess (confidence 0); at confidence 1 both are the same.
    Looser nodes drift along it together: at 1/256 a rendered walker (people-walk) of true depth ends up 4.5 % off. Stiffer ones
    keep the noise of each frame's guess: at 1/4 camel's moving pixels lose .8 dB on frames held out. Chosen of 1/256, 1/16,
    1/4 and 1 on people-walk, procedural, crossing and camel."""
    window: int = 200
    """Longer clips are optimised on random windows of so many frames."""
    redraw: int = 100
    """The coarse ARAP levels are drawn anew every so many steps."""
    seed: int = 0
    graph: GraphConfig = field(default_factory=GraphConfig)

    def decay(self, fraction: float) -> float:
        """Return the factor of the learning rate once `fraction` of the steps are done: 1, then half a cosine to `decay_to`."""
        passed = min(max(fraction - self.decay_start, 0.0) / max(1 - self.decay_start, 1e-9), 1.0)
        return self.decay_to + (1 - self.decay_to) * 0.5 * (1 + float(np.cos(np.pi * passed)))

    def random_window(self, frames: int, generator: np.random.Generator) -> slice:
        """Return the frames of a step: all, or so many in a row as `window` says."""
        first = int(generator.integers(0, max(frames - self.window, 0) + 1))
        return slice(first, first + self.window)

    def terms(self, edges: ArapEdges, kernels: Kernels) -> MotionTerms:
        """Return the losses of the nodes' motion along `edges`."""
        smooth = self.velocity, self.acceleration, self.angular_velocity, self.angular_acceleration
        shifts = dict(zip(self.shifts, self.shift_weights, strict=True))
        return MotionTerms(edges, shifts, MotionWeights(self.coordinate, self.length, *smooth), kernels)


@dataclass(frozen=True)
class Sightlines:
    """Viewing rays of nodes: across a ray a track is known to a pixel, along it as well as depth is."""

    direction: np.ndarray
    """(F, M, 3) unit vectors from the camera to the nodes, world axes."""
    confidence: np.ndarray
    """(F, M) of the depth, 0..1."""


def optimise_geometry(
    scaffold: Scaffold,
    config: GeometryConfig | None = None,
    progress: Progress = silent,
    sightlines: Sightlines | None = None,
    kernels: Kernels = TORCH,
) -> Scaffold:
    """Return the scaffold with positions filled in and smoothed, rotations settled, and its graph built anew.

    Minimises ARAP and smoothness losses over node poses with Adam; rotations are free, observed positions are held as
    `config.certain` says, along their `sightlines` more loosely (`config.along_ray`). While optimising, edges come from
    frames where both nodes were observed; the returned graph uses all frames. A scaffold of one frame or one node has
    nothing to optimise and comes back as it is.
    """
    config = config or GeometryConfig()
    frames, nodes = scaffold.certain.shape
    if frames < 2 or nodes < 2 or config.steps == 0:
        return scaffold
    start = torch.as_tensor(scaffold.xyz, dtype=torch.float32)
    plain = torch.contiguous_format
    xyz = start.clone(memory_format=plain).requires_grad_()
    quat = torch.as_tensor(scaffold.quat, dtype=torch.float32).clone(memory_format=plain).requires_grad_()
    certain = torch.as_tensor(scaffold.certain)[..., None]
    spring = _Spring.of(certain, sightlines, config)
    times = torch.as_tensor(scaffold.times)
    held = certain.sum().clamp(min=1)
    distance = curve_distance(scaffold.xyz, scaffold.certain, config.graph.kth)
    neighbours, edge_mask = build_graph(distance, config.graph.neighbours, config.graph.reach * scaffold.unit)
    optimiser = Adam([{"params": [value], "lr": config.learning_rate} for value in (xyz, quat)], kernels)
    generator = np.random.default_rng(config.seed)

    def placed() -> torch.Tensor:
        """Return the positions (F, M, 3), those observed held in place where they are certain."""
        return torch.where(certain, start, xyz) if config.certain == "hard" else xyz

    for step in range(config.steps):
        if step % config.redraw == 0:
            levels = multilevel_edges(distance, scaffold.unit, config.graph, config.seed + step)
            edges = ArapEdges.build(neighbours, edge_mask, config.graph.base_weight, levels)
            terms = config.terms(edges, kernels)
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * config.decay(step / config.steps)
        window = config.random_window(frames, generator)
        loss = motion_loss(placed()[window], quat[window], times[window], terms)
        if config.certain == "soft":
            loss = loss + config.certain_weight * spring.energy(xyz - start) / held
        loss.backward()
        optimiser.step()
        if step % 10 == 0 or step == config.steps - 1:
            progress("scaffold geometry", step + 1, config.steps, f"loss {loss.item():.5f}")
    poses = {"xyz": placed(), "quat": quaternion.normalize(quat.detach())}
    return with_graph(
        replace(scaffold, **{name: pose.detach().numpy().copy() for name, pose in poses.items()}), config.graph
    )


@dataclass(frozen=True)
class _Spring:
    """Spring that holds observed positions."""

    certain: torch.Tensor
    """(F, M, 1) bool."""
    direction: torch.Tensor | None
    """(F, M, 3) unit vectors; None: it is the same all around."""
    slack: torch.Tensor | None
    """(F, M) 0..1, by how much it is weaker along them."""

    @classmethod
    def of(cls, certain: torch.Tensor, sightlines: Sightlines | None, config: GeometryConfig) -> "_Spring":
        if sightlines is None:
            return cls(certain, None, None)
        slack = 1 - config.along_ray ** (1 - np.clip(sightlines.confidence, 0, 1))
        direction = torch.as_tensor(sightlines.direction, dtype=torch.float32)
        return cls(certain, direction, torch.as_tensor(slack, dtype=torch.float32))

    def energy(self, moved: torch.Tensor) -> torch.Tensor:
        """Return the sum of `|across|^2 + stiffness |along|^2` over the observed ones of `moved (F, M, 3)`."""
        total = (moved.square() * self.certain).sum()
        if self.direction is None or self.slack is None:
            return total
        along = (moved * self.direction).sum(-1)
        return total - (self.slack * along.square() * self.certain[..., 0]).sum()


def with_graph(scaffold: Scaffold, config: GraphConfig, groups: np.ndarray | None = None) -> Scaffold:
    """Return the scaffold with its graph built anew from all frames of its curves, and signs aligned on it."""
    distance = curve_distance(scaffold.xyz, None, config.kth)
    neighbours, edge_mask = build_graph(distance, config.neighbours, config.reach * scaffold.unit, groups)
    quat = align_signs(scaffold.quat, neighbours, edge_mask)
    return replace(scaffold, quat=quat, neighbours=neighbours, edge_mask=edge_mask)
