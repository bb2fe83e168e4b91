"""N Gaussians as they are drawn: one type for numpy and torch, with gsplat's names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Self

from .arrays import Array


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians in the world frame, activated: numpy arrays, or torch tensors of one dtype and device."""

    means: Array
    """(N,3) centres, world units."""
    quats: Array
    """(N,4) rotations wxyz; any length but zero."""
    scales: Array
    """(N,3) standard deviations along the Gaussian's own axes, world units."""
    opacities: Array
    """(N,) in [0, 1]."""
    sh: Array = None
    """(N,S,3) spherical harmonics, S = (degree + 1)^2, directions in the Gaussian's own frame; None where only the shape counts."""

    @property
    def shape(self) -> Splats:
        """Means, quats, scales and opacities alone: what decides where a Gaussian is drawn, whatever its colours are."""
        return Splats(self.means, self.quats, self.scales, self.opacities)

    def __len__(self) -> int:
        return len(self.means)

    def map(self, change: Callable[[Array], Array]) -> Self:
        """Return the Gaussians with `change` applied to each of their arrays, such as `torch.from_numpy` or a selection of rows."""
        return replace(self, **{name: change(array) for name, array in self.arrays().items()})

    def take(self, index: Any) -> Self:
        """Return the Gaussians at `index`: (n,) int, (N,) bool or a slice."""
        return self.map(lambda array: array[index])

    def arrays(self) -> dict[str, Array]:
        """Return the arrays by name, without those that are None."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: array for name, array in named.items() if array is not None}
