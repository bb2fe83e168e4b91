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
from .graph import attach_nodes
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
    """Tracks left out of drift-straight, parkour and horsejump-high are 3.0, 1.1 and .65 pixels off from one frame to the next
    before, .64, .64 and .31 after half as many steps, .59, .48 and .25 after these, .53, .42 and .21 after twice as many."""
    learning_rate: float = 0.002
    """Of node positions (world units) and rotations (quaternion components), falling as in `geometry`. Three times as much leaves
    .1 to .2 pixels more."""
    weight: float = 20.0
    """Weight of the mean angle (radians) by which tracks are missed, beside the losses of `geometry`. A quarter leaves .1 pixels
    more of drift-straight, three times as much makes no difference."""
    along_ray: float = 500.0
    """Stiffness with which nodes keep their distance from the camera, per squared world unit: tracks tell where a node is across
    its ray, its depth was settled before. Samples that also pulled along the ray raised a rendered fox's error of depth from 2.4 to
    3.4 % (with 50 to 2.6, with 5000 as with this); those across it come nearer, too."""
    reach: int = 6
    """A track is carried from each frame in which it was seen to those at most so many frames away; with 2 it is .1 pixels farther
    off two frames away."""
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
    """(P, 3) from this frame's camera to `target`."""
    time: float
    """Clip time of this frame."""
    deformer: Deformer
    mask: Tensor
    """(P, K) bool of the neighbours."""
    native: NativeDeformer | None
    kernel: Kernel

    def carried(self, nodes: NodeTensors) -> Tensor:
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
        return self.native(local, nodes, [self.time])[0][0]

    def miss(self, nodes: NodeTensors, config: FollowingConfig) -> Tensor:
        """Return the mean angle (radians, small ones) between the samples and where the nodes carry them, as the camera sees it."""
        distance = self.ray.square().sum(1, keepdim=True).sqrt()
        error, ray = (self.carried(nodes) - self.target) / distance, self.ray / distance
        squared = (error - (error * ray).sum(1, keepdim=True) * ray).square().sum(1)
        off = squared > 0
        across = torch.where(off, torch.where(off, squared, 1.0).sqrt(), 0.0)  # gradient 0 at 0
        return across.clamp_max(config.lost).mean()


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
    angle between each sample and where the nodes carry it from the frames around, beside the losses of the geometric
    optimisation; distances from the camera stay. A node is certain in the frames in which a track was seen near it.
    `cameras`: one for each frame of the scaffold. Without samples to compare the scaffold comes back as it is.
    """
    config = config or FollowingConfig()
    generator = np.random.default_rng(config.seed)
    frames = list(_samples(scaffold, lifted, cameras, config, kernels, generator)) if config.steps else []
    if not frames or len(scaffold) < 2:
        return scaffold
    xyz, quat = (torch.from_numpy(np.array(part, np.float32, order="C")) for part in (scaffold.xyz, scaffold.quat))
    xyz.requires_grad_()
    quat.requires_grad_()
    nodes, times = NodeTensors(xyz, quat, torch.from_numpy(scaffold.radius)), torch.from_numpy(scaffold.times)
    geometry = config.geometry
    start = xyz.detach().clone()
    view = torch.nn.functional.normalize(start - torch.from_numpy(cameras.centers).to(start)[:, None], dim=-1)
    terms = geometry.terms(ArapEdges.of(scaffold, geometry.graph, config.seed), kernels)
    optimiser = Adam([{"params": [value], "lr": 0.0} for value in (xyz, quat)], kernels)
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * geometry.decay(step / config.steps)
        window = geometry.random_window(len(times), generator)
        chosen = generator.choice(len(frames), min(config.frames, len(frames)), replace=False)
        missed = torch.stack([frames[which].miss(nodes, config) for which in chosen]).mean()
        along = ((xyz - start) * view).sum(-1).square().mean()
        loss = motion_loss(xyz[window], quat[window], times[window], terms)
        loss = loss + config.weight * missed + config.along_ray * along
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
        near = scaffold.neighbours[attach[rows]]
        deformer = Deformer(scaffold.times, reference[rows], near, len(scaffold))
        mask = torch.from_numpy(scaffold.edge_mask[attach[rows]])
        native = NativeDeformer(deformer, mask, config.kernel, kernels.threads) if kernels.native else None
        yield _Samples(
            points=torch.from_numpy(points[rows]),
            reference=torch.from_numpy(reference[rows]),
            attach=torch.from_numpy(attach[rows]),
            target=target,
            ray=target - torch.from_numpy(centre).to(target),
            time=float(scaffold.times[frame]),
            deformer=deformer,
            mask=mask,
            native=native,
            kernel=config.kernel,
        )
