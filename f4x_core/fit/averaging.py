"""The mean of parameters over the last steps of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


class RunningMeans:
    """Means of named tensors over the steps at which they were added.

    A step fits dynamic Gaussians to the one frame that it drew. The mean over many steps is nearer to what suits all frames, and
    rates need not fall for it.
    """

    def __init__(self) -> None:
        """Nothing was added yet."""
        self.means: dict[str, Tensor] = {}
        self.counts: dict[str, int] = {}
        self._leaves: dict[str, Tensor] = {}

    @torch.no_grad()
    def add(self, tensors: Mapping[str, Tensor]) -> None:
        """Count the present values; a tensor that was replaced, as where rows come or go, begins anew."""
        for name, tensor in tensors.items():
            known = name in self.means and self._leaves.get(name, tensor) is tensor
            self._leaves[name] = tensor
            self.counts[name] = self.counts[name] + 1 if known else 1
            if known:
                self.means[name].lerp_(tensor.detach(), 1 / self.counts[name])
            else:
                self.means[name] = tensor.detach().clone()

    @torch.no_grad()
    def put(self, tensors: Mapping[str, Tensor]) -> None:
        """Give the tensors that were counted their means."""
        for name, tensor in tensors.items():
            if self._leaves.get(name) is tensor:
                tensor.copy_(self.means[name])

    def state(self) -> dict[str, Any]:
        """Return the means and counts for `restore`."""
        return {"means": dict(self.means), "counts": dict(self.counts)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken; the tensors counted next are those that were counted then."""
        self.means = {name: mean.clone() for name, mean in state["means"].items()}
        self.counts, self._leaves = dict(state["counts"]), {}
