"""The control radius `sigma = sigma_max * sigmoid(logit)`. numpy or torch."""

from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, namespace


@dataclass(frozen=True)
class RadiusConfig:
    """Radii as multiples of the node spacing `unit`."""

    initial: float = 1.0
    """Start value; on made-up rigid, jointed and waving motions 1 carries unseen points better than 1.5 or 2."""
    maximum: float = 5.0
    """Upper bound while the radius is optimised."""


_RATIO_MARGIN = 1e-5  # keeps the logit finite when a radius touches its bound


def initial_radius(nodes: int, unit: float, config: RadiusConfig | None = None) -> np.ndarray:
    """Return start radii `(M,)` float32 in world units."""
    return np.full(nodes, (config or RadiusConfig()).initial * unit, np.float32)


def radius_to_logit(radius: Array, maximum: float) -> Array:
    """Return the optimiser's parameter of radii in `(0, maximum)`."""
    xp = namespace(radius)
    ratio = xp.clip(radius / maximum, _RATIO_MARGIN, 1 - _RATIO_MARGIN)
    return xp.log(ratio / (1 - ratio))


def radius_from_logit(logit: Array, maximum: float) -> Array:
    """Return radii in `(0, maximum)`; the inverse of `radius_to_logit`."""
    return maximum / (1 + namespace(logit).exp(-logit))
