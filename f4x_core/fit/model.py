"""Everything that the trainer optimises, and how it looks at one time: two Gaussian sets, scaffold, cameras."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..gaussians import DynamicGaussians, GaussianSet, StaticGaussians, appearance
from ..gaussians.appearance_native import COEFFICIENTS, Drawing, Drawn, DrawnSet, NativeDrawing
from ..gaussians.camera_rig import CameraRig
from ..gaussians.parameters import OPACITY_MARGIN, WHOLE
from ..geometry import quaternion
from ..geometry.camera import Camera
from ..geometry.splats import Splats
from ..native.kernels import TORCH, Kernels
from ..raster import RasterConfig, RasterOutput, rasterize
from ..scaffold import Scaffold
from ..scaffold.deformation.native.autograd import GaussianTensors, NativeDeformer, NodeTensors
from ..scaffold.deformation.sparse import Deformer
from ..scaffold.graph import GraphConfig
from ..scaffold.losses import ArapEdges
from ..scaffold.radius import RadiusConfig, radius_from_logit, radius_to_logit
from ..scaffold.skinning import Kernel


@dataclass
class NodeSet:
    """The scaffold during optimisation.

    `parameters`: `node_xyz` (F,M,3), `node_quat` (F,M,4), `radius_logit` (M,), all requiring grad. The graph is numpy-side
    state: `scaffold` holds neighbours, masks, ids and certainty and is refreshed from the parameters when it is rebuilt.
    """

    scaffold: Scaffold
    graph: GraphConfig
    parameters: dict[str, Tensor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Take the start values from the scaffold when none are given."""
        if not self.parameters:
            start = {
                "node_xyz": self.scaffold.xyz,
                "node_quat": self.scaffold.quat,
                "radius_logit": radius_to_logit(self.scaffold.radius, self.radius_limit),
            }
            self.parameters = {
                name: torch.from_numpy(np.ascontiguousarray(value, np.float32)).clone().requires_grad_(True)
                for name, value in start.items()
            }
        self.neighbours = torch.from_numpy(self.scaffold.neighbours).long()
        self.edge_mask = torch.from_numpy(self.scaffold.edge_mask)
        self.edges = ArapEdges.of(self.scaffold, self.graph)

    @property
    def radius_limit(self) -> float:
        """Upper bound of the control radii, world units."""
        return RadiusConfig().maximum * self.scaffold.unit

    @property
    def radius(self) -> Tensor:
        """(M,) control radii, world units."""
        return radius_from_logit(self.parameters["radius_logit"], self.radius_limit)

    @property
    def quat(self) -> Tensor:
        """(F,M,4) unit quaternions."""
        return quaternion.normalize(self.parameters["node_quat"])

    def snapshot(self) -> Scaffold:
        """Return the scaffold with the parameters' present values."""
        with torch.no_grad():
            return dataclasses.replace(
                self.scaffold,
                xyz=self.parameters["node_xyz"].numpy().copy(),
                quat=self.quat.numpy().copy(),
                radius=self.radius.numpy().copy(),
            )


@dataclass(frozen=True, eq=False)
class Attachment:
    """Nodes of the dynamic Gaussians, and data derived from them."""

    attach: Tensor
    """(N,) index of each Gaussian's node."""
    nodes: NodeSet
    edge_mask: Tensor
    """(N,K) bool of each Gaussian's neighbours."""
    deformer: Deformer
    native: NativeDeformer | None
    """The deformer of the compiled library, where that is used."""
    born: Tensor
    """(N,) float32 clip time at which each Gaussian has its reference."""


class Present(NamedTuple):
    """M of the dynamic Gaussians: those that are there at some time."""

    gaussians: DynamicGaussians
    """The M; they send their gradients to the whole set."""
    born: Tensor
    """(M,) clip time at which each has its reference."""
    rows: Tensor | None
    """(M,) int64 their rows in the whole set; None for all."""


class Moved(NamedTuple):
    """M dynamic Gaussians at one time."""

    means: Tensor
    """(M,3)"""
    quats: Tensor
    """(M,4)"""
    time: float
    """Clip time."""
    present: Present
    """The Gaussians that were moved."""


def _centre(camera: Camera) -> tuple[float, float, float]:
    """Return `camera.center` in plain numbers, without gradients: see `camera_rig.CorrectedView`."""
    rows = camera.world_to_camera[:3].tolist()
    x, y, z = (-sum(row[axis] * row[3] for row in rows) for axis in range(3))
    return x, y, z


@dataclass(eq=False)
class SceneModel:
    """The scene under optimisation; `dynamic` and `nodes` are None where nothing moves."""

    static: StaticGaussians
    dynamic: DynamicGaussians | None
    nodes: NodeSet | None
    rig: CameraRig
    kernel: Kernel
    """Skinning kernel."""
    kernels: Kernels = TORCH
    """Compiled or torch code that moves and colours the Gaussians."""
    frozen: Splats | None = None
    """Gaussians that are drawn and never change: tensors with harmonics of the degree of the others."""
    _attachment: Attachment | None = field(default=None, init=False)

    @property
    def times(self) -> np.ndarray:
        """(F,) clip times of the supervised frames."""
        return self.rig.path.times

    def __len__(self) -> int:
        """Return the number of Gaussians of both sets."""
        return len(self.static) + (0 if self.dynamic is None else len(self.dynamic))

    def sets(self) -> Iterator[tuple[str, StaticGaussians | DynamicGaussians]]:
        """Yield the optimised sets by name, in the order in which they are drawn."""
        yield "static", self.static
        if self.dynamic is not None:
            yield "dynamic", self.dynamic

    def rows(self) -> Iterator[tuple[str, slice]]:
        """Yield the rows of each optimised set, by name, among all Gaussians drawn."""
        first = 0
        for name, gaussians in self.sets():
            yield name, slice(first, first + len(gaussians))
            first += len(gaussians)

    @property
    def attachment(self) -> Attachment:
        """Made again whenever Gaussians or the graph were replaced."""
        assert self.dynamic is not None
        assert self.nodes is not None
        attach, reference, nodes = self.dynamic.labels["attach"], self.dynamic.labels["reference"], self.nodes
        known = self._attachment
        if known is None or known.attach is not attach or known.nodes is not nodes:
            mask = nodes.edge_mask[attach]
            deformer = Deformer(self.times, reference, nodes.neighbours[attach], len(nodes.scaffold))
            threads = self.kernels.threads
            native = NativeDeformer(deformer, mask, self.kernel, threads) if self.kernels.native else None
            born = torch.from_numpy(np.asarray(self.times, np.float32))[reference]
            self._attachment = known = Attachment(attach, nodes, mask, deformer, native, born)
        return known

    def skinning(self, x_reference: Tensor) -> tuple[Tensor, Tensor]:
        """Return the weights (N,K) and identity strength (N,) of the dynamic Gaussians at their reference positions (N,3)."""
        assert self.dynamic is not None
        assert self.nodes is not None
        known = self.attachment
        dw = self.dynamic.parameters["dw"] if self.dynamic.use_dw else None
        weights, strength = known.deformer.skinning(
            x_reference, self.nodes.parameters["node_xyz"], self.nodes.radius, known.edge_mask, dw, self.kernel
        )
        # Points far from every node follow their nearest ones instead of fading to rest: the spawn mask says they move.
        return weights, torch.ones_like(strength)

    @property
    def born(self) -> Tensor:
        """(N,) float32 clip time at which each dynamic Gaussian has its reference."""
        return self.attachment.born

    @property
    def all_dynamic(self) -> Present:
        """All dynamic Gaussians, whether they are there or not."""
        assert self.dynamic is not None
        return Present(self.dynamic, self.born, None)

    def present_at(self, time: float) -> Present:
        """Return the dynamic Gaussians that are there at the clip time `time`: of fast things one in ten."""
        assert self.dynamic is not None
        with torch.no_grad():
            there = self.dynamic.presence(time - self.born) > 0
        if bool(there.all()):
            return self.all_dynamic
        rows = there.nonzero()[:, 0]
        return Present(self.dynamic.taken(rows), self.born[rows], rows)

    def dynamic_at(self, *times: float, present: Present | None = None) -> list[Moved]:
        """Return the Gaussians `present`, or all dynamic ones, at each of `times` (clip times), be they there then or not."""
        assert self.nodes is not None
        xyz = self.nodes.parameters["node_xyz"]
        attachment, present = self.attachment, present or self.all_dynamic
        if attachment.native is not None:
            own = present.gaussians.parameters
            dw = own["dw"] if present.gaussians.use_dw else None
            gaussians = GaussianTensors(own["local_means"], own["local_quats"], dw)
            nodes = NodeTensors(xyz, self.nodes.parameters["node_quat"], self.nodes.radius)
            moved = attachment.native(gaussians, nodes, times, present.rows)
            return [Moved(*each, time, present) for each, time in zip(moved, times, strict=True)]
        assert self.dynamic is not None
        quat = self.nodes.quat
        x, q = self.dynamic.at_reference(xyz, quat)
        weights, strength = self.skinning(x)
        rows = slice(None) if present.rows is None else present.rows
        posed = []
        for time in times:
            turn, shift = attachment.deformer(xyz, quat, weights, strength, time)
            means, quats = quaternion.rotate(turn, x) + shift, quaternion.multiply(turn, q)
            posed.append(Moved(means[rows], quats[rows], time, present))
        return posed

    def posed(self, moved: Moved | None, still: bool = False) -> Splats:
        """Return the static Gaussians, then the dynamic ones `moved` (of `dynamic_at`; None = none), frozen ones last.

        With `still`, static ones get no gradient.
        """
        first = self.static.splats(self.static.parameters["means"], self.static.parameters["quats"])
        parts = [first.map(Tensor.detach) if still else first]
        if moved is not None:
            own = moved.present
            parts.append(own.gaussians.splats_there(moved.means, moved.quats, moved.time - own.born))
        if self.frozen is not None:
            parts.append(self.frozen)
        if len(parts) == 1:
            return parts[0]
        return Splats(**{name: torch.cat([getattr(part, name) for part in parts]) for name in parts[0].arrays()})

    def drawn(self, moved: Moved | None, camera: Camera, there: Tensor | None = None, still: bool = False) -> Drawn:
        """Return all Gaussians of `posed` as the raster takes them, with their channels as `camera` sees them.

        Channels: rgb; where something moves which Gaussians are dynamic; with `there` (M,3), the places of the M dynamic
        Gaussians at another time, the places of all then, static ones staying put. They send no gradient to the camera, and
        with `still` none to the static Gaussians.
        """
        if not self.kernels.native or self.static.parameters["shN"].shape[1] + 1 not in COEFFICIENTS:
            splats = self.posed(moved, still)
            colors = appearance(splats.sh, splats.means, splats.quats, camera.center.detach(), self.kernels)
            more = self._more_channels(splats.means, moved, there)
            return Drawn(splats.means, splats.quats, splats.scales, splats.opacities, torch.cat([colors, *more], 1))
        sets, time, born, channels = [self._drawn_set(self.static)], 0.0, None, 3
        if still:
            sets = [DrawnSet(*(None if tensor is None else tensor.detach() for tensor in sets[0]))]  # type: ignore[arg-type]
        if moved is not None:
            sets.append(self._drawn_set(moved.present.gaussians, moved, there))
            time, born, channels = moved.time, moved.present.born, 4 if there is None else 7
        frozen = None
        if self.frozen is not None:
            own = self.frozen
            frozen = Drawn(own.means, own.quats, own.scales, own.opacities, own.means.new_empty(0)), own.sh
        drawing = Drawing(_centre(camera), channels, time, born, WHOLE, OPACITY_MARGIN, frozen, self.kernels.threads)
        return Drawn(*NativeDrawing.apply(drawing, *(tensor for own in sets for tensor in own)))

    @staticmethod
    def _drawn_set(gaussians: GaussianSet, moved: Moved | None = None, there: Tensor | None = None) -> DrawnSet:
        own = gaussians.parameters
        means, quats = (own["means"], own["quats"]) if moved is None else (moved.means, moved.quats)
        scales, opacities = own["log_scales"], own["opacity_logits"]
        return DrawnSet(means, quats, scales, opacities, own["sh0"], own["shN"], own.get("log_lifetimes"), there)

    def _more_channels(self, means: Tensor, moved: Moved | None, there: Tensor | None) -> list[Tensor]:
        """Return the channels of `drawn` behind rgb."""
        if moved is None:
            return []
        own = slice(len(self.static), len(self.static) + len(moved.means))
        mark = means.new_zeros(len(means), 1)
        mark[own] = 1
        still = means.detach()
        return [mark] if there is None else [mark, torch.cat([still[: own.start], there, still[own.stop :]])]

    def render(
        self,
        splats: Splats,
        camera: Camera,
        *,
        extra: Tensor | None = None,
        background: Tensor | None = None,
        config: RasterConfig | None = None,
        backend: str = "auto",
    ) -> RasterOutput:
        """Composite rgb (3 channels), then `extra` (N,E) channels; the background (3,) is added to rgb only."""
        colors = appearance(splats.sh, splats.means, splats.quats, camera.center.detach(), self.kernels)
        if extra is not None:
            colors = torch.cat([colors, extra], 1)
        if background is not None and extra is not None:
            background = torch.cat([background, background.new_zeros(extra.shape[1])])
        return rasterize(
            splats,
            colors,
            camera,
            background=background,
            config=config,
            backend=backend,
        )
