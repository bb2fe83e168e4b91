"""Moves the nodes so that they carry every lifted track along its own sightings, not only those that became nodes. torch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from ..geometry import pose, quaternion
from ..geometry.camera import CameraPath
from ..native.kernels import TORCH, Kernels
from ..progress import Progress, silent
from .adam import Adam
from .deformation.native.autograd import GaussianTensors, NativeDeformer, NodeTensors
from .deformation.sparse import Deformer
from .distance import curve_distance
from .graph import attach_nodes, multilevel_edges
from .lifting import LiftedTracks
from .losses import ArapEdges, motion_loss
from .optimise import GeometryConfig, with_graph
from .skinning import Kernel
from .structure import Scaffold

SUPPORT = 0.5
"""Radii of a node within which a track that is seen tells where it is. With 1 moving Gaussians live longer and are fewer: parkour
.1 dB better between the given frames and 1.2 worse in them, horsejump-high the same."""


@dataclass(frozen=True)
class FollowingConfig:
    """Settings of `follow_tracks`."""

    steps: int = 300
    """Twice as many bring held-out tracks of drift-straight, parkour and horsejump-high from .5, .4 and .2 pixels to the same."""
    learning_rate: float = 0.002
    """Of node positions (world units) and rotations (quaternion components); it falls as that of the geometric optimisation."""
    weight: float = 20.0
    """Weight of the mean angle (radians) by which tracks are missed, beside the losses of `geometry`."""
    along_ray: float = 0.1
    """Weight of an error along the viewing ray, as a fraction of the distance, against the same one across it: depth is a guess."""
    reach: int = 6
    """A track is carried from each frame in which it was seen to those at most so many frames away."""
    lost: float = 0.07
    """Radians; a sample farther off was followed onto something else, and pulls at nothing."""
    frames: int = 8
    """Frames compared in each step."""
    samples: int = 1500
    """Most samples that are carried to a frame."""
    seed: int = 0
    geometry: GeometryConfig = field(default_factory=GeometryConfig)
    """Losses that keep shapes and smooth motions."""
    kernel: Kernel = "sigma"
    """Skinning kernel."""


@dataclass(frozen=True, eq=False)
class _Nodes:
    """The nodes under optimisation."""

    xyz: Tensor
    """(F, M, 3)"""
    quat: Tensor
    """(F, M, 4) of any length."""
    radius: Tensor
    """(M,)"""


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of tracks that were seen in other frames and in this one."""

    points: Tensor
    """(P, 3) where they were seen there."""
    reference: Tensor
    """(P,) int64, the frames in which they were seen."""
    attach: Tensor
    """(P,) int64 nearest node there."""
    target: Tensor
    """(P, 3) where they are seen here."""
    ray: Tensor
    """(P, 3) unit vectors from this frame's camera to `target`."""
    distance: Tensor
    """(P,) of `target` from the camera."""
    time: float
    """Clip time of this frame."""
    deformer: Deformer
    mask: Tensor
    """(P, K) bool of the neighbours."""
    native: NativeDeformer | None
    kernel: Kernel

    def carried(self, nodes: _Nodes) -> Tensor:
        """Return (P, 3) the points as the nodes carry them from their frames to this one."""
        if self.native is None:
            weights, strength = self.deformer.skinning(
                self.points, nodes.xyz, nodes.radius, self.mask, None, self.kernel
            )
            turn, shift = self.deformer(nodes.xyz, nodes.quat, weights, torch.ones_like(strength), self.time)
            return quaternion.rotate(turn, self.points) + shift
        turn = quaternion.normalize(nodes.quat[self.reference, self.attach])
        back = pose.invert(turn, nodes.xyz[self.reference, self.attach])
        local = GaussianTensors(pose.transform(*back, self.points), back[0], None)
        return self.native(local, NodeTensors(nodes.xyz, nodes.quat, nodes.radius), [self.time])[0][0]

    def miss(self, nodes: _Nodes, config: FollowingConfig) -> Tensor:
        """Return the mean by which the nodes miss the samples: radians across the ray, and fractions of the distance along it."""
        error = (self.carried(nodes) - self.target) / self.distance[:, None]
        along = (error * self.ray).sum(1)
        squared = (error - along[:, None] * self.ray).square().sum(1)
        off = squared > 0
        across = torch.where(off, torch.where(off, squared, 1.0).sqrt(), 0.0)  # gradient 0 at 0
        return (across.clamp_max(config.lost) + config.along_ray * along.abs().clamp_max(config.lost)).mean()


def follow_tracks(
    scaffold: Scaffold,
    lifted: LiftedTracks,
    cameras: CameraPath,
    config: FollowingConfig | None = None,
    kernels: Kernels = TORCH,
    progress: Progress = silent,
) -> Scaffold:
    """Return the scaffold with nodes moved so that it carries the tracks along their sightings, and its graph built anew.

    Nodes are a few of the tracks; where these were not seen, or are a little wrong, the others know better. Minimises the
    distance of each sample from where the nodes carry it from the frames around, beside the losses of the geometric
    optimisation. A node is certain in the frames in which a track was seen near it. `cameras`: one for each frame
    of the scaffold. Without samples to compare it comes back as it is.
    """
    config = config or FollowingConfig()
    generator = np.random.default_rng(config.seed)
    frames = list(_samples(scaffold, lifted, cameras, config, kernels, generator)) if config.steps else []
    if not frames or len(scaffold) < 2:
        return scaffold
    xyz, quat = (torch.from_numpy(np.array(part, np.float32, order="C")) for part in (scaffold.xyz, scaffold.quat))
    xyz.requires_grad_()
    quat.requires_grad_()
    nodes, times = _Nodes(xyz, quat, torch.from_numpy(scaffold.radius)), torch.from_numpy(scaffold.times)
    geometry = config.geometry
    distance = curve_distance(scaffold.xyz, None, geometry.graph.kth)
    levels = multilevel_edges(distance, scaffold.unit, geometry.graph, config.seed)
    edges = ArapEdges.build(scaffold.neighbours, scaffold.edge_mask, geometry.graph.base_weight, levels)
    terms = geometry.terms(edges, kernels)
    optimiser = Adam([{"params": [value], "lr": 0.0} for value in (xyz, quat)], kernels)
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * geometry.decay(step / config.steps)
        window = geometry.random_window(len(times), generator)
        chosen = generator.choice(len(frames), min(config.frames, len(frames)), replace=False)
        missed = torch.stack([frames[which].miss(nodes, config) for which in chosen]).mean()
        loss = motion_loss(xyz[window], quat[window], times[window], terms) + config.weight * missed
        loss.backward()
        optimiser.step()
        if step % 10 == 0 or step == config.steps - 1:
            progress("scaffold tracks", step + 1, config.steps, f"loss {loss.item():.5f}")
    moved = replace(scaffold, xyz=xyz.detach().numpy(), quat=quaternion.normalize(quat.detach()).numpy())
    return with_graph(replace(moved, certain=_supported(moved, lifted)), geometry.graph)


def _supported(scaffold: Scaffold, lifted: LiftedTracks) -> np.ndarray:
    """Return (F, M) bool: a track was seen in that frame near the node."""
    from scipy.spatial import cKDTree

    supported = np.zeros_like(scaffold.certain)
    for frame, seen in enumerate(lifted.certain):
        if seen.any():
            supported[frame] = (
                cKDTree(lifted.xyz[frame, seen]).query(scaffold.xyz[frame])[0] <= SUPPORT * scaffold.radius
            )
    return supported


def _samples(
    scaffold: Scaffold,
    lifted: LiftedTracks,
    cameras: CameraPath,
    config: FollowingConfig,
    kernels: Kernels,
    generator: np.random.Generator,
) -> Iterator[_Samples]:
    """Yield the samples of each frame in which tracks were seen that other frames near it see, too."""
    reference, track = np.nonzero(lifted.certain)
    points = lifted.xyz[reference, track]
    attach = attach_nodes(points, reference, scaffold.xyz)
    for frame, centre in enumerate(cameras.centers):
        apart = np.abs(reference - frame)
        rows = np.flatnonzero((apart > 0) & (apart <= config.reach) & lifted.certain[frame, track])
        if len(rows) > config.samples:
            rows = np.sort(generator.choice(rows, config.samples, replace=False))
        if not len(rows):
            continue
        target = torch.from_numpy(lifted.xyz[frame, track[rows]])
        ray = target - torch.from_numpy(centre).to(target)
        distance = torch.linalg.vector_norm(ray, dim=1)
        near = scaffold.neighbours[attach[rows]]
        deformer = Deformer(scaffold.times, reference[rows], near, len(scaffold))
        mask = torch.from_numpy(scaffold.edge_mask[attach[rows]])
        native = NativeDeformer(deformer, mask, config.kernel, kernels.threads) if kernels.native else None
        yield _Samples(
            torch.from_numpy(points[rows]),
            torch.from_numpy(reference[rows]),
            torch.from_numpy(attach[rows]),
            target,
            ray / distance[:, None],
            distance,
            float(scaffold.times[frame]),
            deformer,
            mask,
            native,
            config.kernel,
        )
