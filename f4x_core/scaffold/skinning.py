"""Skinning: the weights with which nodes carry Gaussians (MoSca Eq. 1). numpy or torch; needs numpy alone."""

from typing import Literal, NamedTuple

import numpy as np

from ..geometry.arrays import Array, namespace

Kernel = Literal["sigma", "paper"]

FLOOR = 1e-6
"""Every valid neighbour weighs at least this, so a far point still follows its neighbours in proportion (MoSca v2)."""
MIN_SPREAD = 1e-12
"""Lower bound of sigma^2 or r: a node with radius 0 carries exactly the points that lie on it."""


class SkinningWeights(NamedTuple):
    """Weights of each Gaussian's neighbours, and how far it follows them."""

    weights: Array
    """(N, K) sums to 1; all 0 for a point that no node carries."""
    strength: Array
    """(N,) in [0, 1]: 0 keeps the point at rest, 1 lets it follow its nodes."""


def skinning_weights(
    x: Array, node_x: Array, radius: Array, mask: Array, dw: Array | None = None, kernel: Kernel = "sigma"
) -> SkinningWeights:
    """Return the skinning weights of N points, K neighbours each.

    `x (N, 3)` are points and `node_x (N, K, 3)` their neighbours' positions at the reference time, world units;
    `radius (N, K)`, `mask (N, K)` bool. The raw weight is `exp(-d^2 / 2 sigma^2)` (kernel "sigma", MoSca's code) or
    `exp(-d^2 / 2 r)` (kernel "paper"), plus a floor; with `dw (N, K)`, the learnt correction, it becomes `|g + dw|`.
    `strength = clamp(sum of raw weights, 0, 1)` fades points far from every node to the identity.
    """
    xp = namespace(x, node_x, radius)
    offset = x[..., None, :] - node_x  # (N, K, 3)
    squared = (offset * offset).sum(axis=-1)
    spread = radius * radius if kernel == "sigma" else radius
    raw = (xp.exp(-0.5 * squared / xp.clip(spread, MIN_SPREAD, None)) + FLOOR) * mask
    if dw is not None:
        raw = abs(raw + dw) * mask
    total = raw.sum(axis=1, keepdims=True)
    # The divisor is made safe first: a point without weights keeps zeros, and its gradient stays finite.
    empty = total <= np.finfo(np.float32).tiny
    weights = raw / xp.where(empty, xp.ones_like(total), total)
    return SkinningWeights(weights, xp.clip(total[..., 0], 0.0, 1.0))
