"""The as-rigid-as-possible losses and their gradients by the compiled library. float32 on the CPU."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..errors import F4xError
from ..native.arap import ARAP, F4X_ARAP

Edges = tuple[Tensor, Tensor, Tensor, int]
"""Node, neighbour and weight of each edge, and how many come before those that send no gradient to the neighbour's position."""
Pairs = Sequence[tuple[int, float]]
"""Frame distances and their factors."""


def arap(xyz: Tensor, axes: Tensor, edges: Edges, pairs: Pairs, threads: int) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the losses `(2,)` float64 of coordinates and lengths, and their gradients, by name.

    Args:
        xyz: (F,M,3) positions. axes: (F,M,3,3) the nodes' axes as columns. threads: they change no bit.

    Raises:
        F4xError: memory ran out.
    """
    node, neighbour, weight, leading = edges
    gradients = {"d_coordinate": torch.empty_like(xyz), "d_length": torch.empty_like(xyz)}
    gradients["d_axes"] = torch.empty_like(axes)
    losses = torch.empty(2, dtype=torch.float64)
    problem = ARAP(
        edges=len(node),
        leading=leading,
        frames=len(xyz),
        nodes=xyz.shape[1],
        shifts=len(pairs),
        threads=threads,
        xyz=xyz,
        axes=axes,
        node=node,
        neighbour=neighbour,
        weight=weight,
        shift=torch.tensor([shift for shift, _ in pairs], dtype=torch.int32),
        factor=torch.tensor([factor / (len(xyz) - shift) for shift, factor in pairs]),
        losses=losses,
        **gradients,
    )
    if F4X_ARAP(problem):
        raise F4xError(
            f"The scaffold ran out of memory at {xyz.shape[1]} nodes: give fewer by --set scaffold.max_nodes."
        )
    return losses, gradients
