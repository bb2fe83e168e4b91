"""The two parameter sets that are optimised: Gaussians of the static world, and Gaussians carried by the scaffold.

Values are stored unactivated (`log_scales`, `opacity_logits`). Colours are spherical harmonics whose directions are taken in
the Gaussian's own frame, so that appearance turns with the surface (MoSca).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from ..geometry import pose, quaternion, spherical_harmonics
from ..geometry.splats import Splats
from ..native.kernels import TORCH, Kernels
from .appearance_native import COEFFICIENTS, NativeAppearance

# A Gaussian is wholly there for this fraction of its lifetime, and fades over the rest.
WHOLE = 0.5
# Opacities are kept this far from 0 and 1 before taking the logit, so that its gradient stays finite.
OPACITY_MARGIN = 1e-4


@dataclass
class GaussianSet:
    """N Gaussians as named tensors that share their first dimension.

    Attributes:
        parameters: optimised tensors, all requiring grad: `log_scales` (N,3), `opacity_logits` (N,), `sh0` (N,1,3),
            `shN` (N,S-1,3), and the placement tensors of the subclass.
        labels: tensors that travel with the Gaussians: `ids` (N,) int64, never reused; `reach` (N,) float32, the depth in world
            units from which they were seen, in which their steps and sizes are measured; and those of the subclass.
    """

    parameters: dict[str, Tensor]
    labels: dict[str, Tensor]

    def __len__(self) -> int:
        return len(self.labels["ids"])

    @property
    def scales(self) -> Tensor:
        """(N,3) activated standard deviations, world units."""
        return self.parameters["log_scales"].exp()

    @property
    def opacities(self) -> Tensor:
        """(N,) activated opacity in (0, 1)."""
        return self.parameters["opacity_logits"].sigmoid()

    @property
    def sh(self) -> Tensor:
        """(N,S,3) spherical-harmonic coefficients, DC first."""
        first, more = self.parameters["sh0"], self.parameters["shN"]
        return torch.cat([first, more], 1) if more.shape[1] else first

    def followed_by(self, others: Self) -> Self:
        """Return these Gaussians, then `others`, as at the start of a fit."""
        with torch.no_grad():
            parameters = {n: torch.cat([p, others.parameters[n]]) for n, p in self.parameters.items()}
        labels = {n: torch.cat([label, others.labels[n]]) for n, label in self.labels.items()}
        return type(self)({n: p.requires_grad_(True) for n, p in parameters.items()}, labels)

    def taken(self, rows: Tensor) -> Self:
        """Return the Gaussians `rows (M,)`, which send their gradients here."""
        parameters, labels = (
            {name: tensor.index_select(0, rows) for name, tensor in tensors.items()}
            for tensors in (self.parameters, self.labels)
        )
        return replace(self, parameters=parameters, labels=labels)

    def splats(self, means: Tensor, quats: Tensor) -> Splats:
        """Return the Gaussians, activated, at `means` (N,3) and `quats` (N,4) in the world."""
        return Splats(means, quats, self.scales, self.opacities, self.sh)


class StaticGaussians(GaussianSet):
    """Gaussians that do not move: placement `means` (N,3) and `quats` (N,4), world frame.

    Label `earlier` (N,) bool: it goes on from one of an earlier fit.
    """


@dataclass
class DynamicGaussians(GaussianSet):
    """Gaussians carried by the scaffold.

    Placement `local_means` (N,3), `local_quats` (N,4) is in the frame of the attach node at the reference frame, so that moving a
    node moves its Gaussians at their own reference time too. `dw` (N,K) is the learnable offset of Eq. 1. Labels: `attach`
    (N,) node index, `reference` (N,) index into the scaffold's times. `log_lifetimes` (N,2) are the logarithms of the times in
    clip frames, before and after its reference time, in which a Gaussian is gone: where nodes do not carry it rightly, it had
    better not be there (a trapezoid in place of the Gaussian over time of Li et al., Spacetime Gaussian Feature Splatting,
    CVPR 2024, Eq. 7).
    """

    use_dw: bool = field(default=False)

    def presence(self, away: Tensor) -> Tensor:
        """Return (N,) in [0, 1]: how much of each Gaussian is there `away` (N,) clip frames after its reference time."""
        before, after = self.parameters["log_lifetimes"].exp().unbind(1)
        return ((1 - away.abs() / torch.where(away < 0, before, after)) / (1 - WHOLE)).clamp(0, 1)

    def spans(self, born: Tensor) -> Tensor:
        """Return (N,4) clip times between which Gaussians come, and go, as scenes have them; `born` (N,): reference times."""
        before, after = self.parameters["log_lifetimes"].exp().unbind(1)
        return born[:, None] + torch.stack([-before, -WHOLE * before, WHOLE * after, after], 1)

    def splats_there(self, means: Tensor, quats: Tensor, away: Tensor) -> Splats:
        """Return the Gaussians as `splats` has them, faded as scenes fade them: optical depth, not opacity."""
        depth = -torch.log1p(-self.opacities.clamp(max=1 - OPACITY_MARGIN))
        return Splats(means, quats, self.scales, -torch.expm1(-self.presence(away) * depth), self.sh)

    def at_reference(self, node_xyz: Tensor, node_quat: Tensor) -> tuple[Tensor, Tensor]:
        """Return the positions (N,3) and orientations (N,4) in the world at each Gaussian's own reference time.

        Args:
            node_xyz: (F,M,3) node positions. node_quat: (F,M,4) unit quaternions wxyz.
        """
        reference, attach = self.labels["reference"], self.labels["attach"]
        row = reference * node_xyz.shape[1] + attach  # (N,) row of the flattened (F*M) table
        t = torch.nn.functional.embedding(row, node_xyz.reshape(-1, 3))
        q = torch.nn.functional.embedding(row, node_quat.reshape(-1, 4))
        x = pose.transform(q, t, self.parameters["local_means"])
        return x, quaternion.multiply(q, quaternion.normalize(self.parameters["local_quats"]))


def localise(
    x: Tensor, q: Tensor, attach: Tensor, reference: Tensor, node_xyz: Tensor, node_quat: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the inverse of `DynamicGaussians.at_reference`: world placement (N,3), (N,4) -> local frame of the attach node."""
    node_q, node_t = node_quat[reference, attach], node_xyz[reference, attach]
    inverse = quaternion.conjugate(node_q)
    return quaternion.rotate(inverse, x - node_t), quaternion.multiply(inverse, q)


def appearance(sh: Tensor, means: Tensor, quats: Tensor, centre: Tensor, kernels: Kernels = TORCH) -> Tensor:
    """Return the colours (N,3) seen from a camera centre (3,): SH evaluated along the view direction in the Gaussian's own frame.

    `quats` (N,4) may have any length. The compiled library does it where `kernels` say so (float32 on the CPU, degree 3 at
    most; higher degrees stay in torch); the centre then has no gradient.
    """
    if kernels.native and sh.shape[1] in COEFFICIENTS:
        return NativeAppearance.apply(sh, means, quats, centre, kernels.threads)
    direction = torch.nn.functional.normalize(means - centre, dim=1)  # (N,3)
    own = quaternion.rotate(quaternion.conjugate(quats), direction)
    return spherical_harmonics.evaluate(sh, own)


def opacity_logit(opacity: Tensor) -> Tensor:
    """Return the inverse sigmoid with a margin that keeps it finite."""
    return torch.logit(opacity, eps=OPACITY_MARGIN)
