"""Heads: small perceptrons that decode the latent to the features of one teacher."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Self, cast

import numpy as np
import torch
from torch import Tensor, nn


def head_widths(latent: int, channels: int) -> list[int]:
    """Return the layer widths from the latent to `channels`, doubling between: 32-64-128-256-512-1024-1408."""
    widths = [latent]
    while 2 * widths[-1] < channels:
        widths.append(2 * widths[-1])
    return [*widths, channels]


class Head(nn.Module):
    """Linear layers with ReLU between and a linear end: (…,D) -> (…,C)."""

    def __init__(self, widths: list[int]):
        """Build layers of the given widths, first D and last C."""
        super().__init__()
        self.chain = nn.ModuleList(nn.Linear(before, after) for before, after in pairwise(widths))

    @property
    def layers(self) -> list[nn.Linear]:
        """The linear layers, first to last."""
        return [cast(nn.Linear, layer) for layer in self.chain]

    def forward(self, latent: Tensor) -> Tensor:
        """Return the features (…,C) of `latent (…,D)`."""
        *inner, last = self.layers
        for layer in inner:
            latent = torch.relu(layer(latent))
        return last(latent)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return `weight_i` (in,out) and `bias_i` (out,) float32, as the scene file names them."""
        arrays = {}
        for i, layer in enumerate(self.layers):
            arrays[f"weight_{i}"] = layer.weight.detach().cpu().numpy().T.copy()
            arrays[f"bias_{i}"] = layer.bias.detach().cpu().numpy().copy()
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        """Return the head that `to_arrays` gave, in float32."""
        weights = [arrays[f"weight_{i}"] for i in range(len(arrays) // 2)]
        head = cls([len(weights[0]), *(weight.shape[1] for weight in weights)])
        with torch.no_grad():
            for i, layer in enumerate(head.layers):
                layer.weight.copy_(torch.from_numpy(weights[i].T.astype(np.float32)))
                layer.bias.copy_(torch.from_numpy(arrays[f"bias_{i}"].astype(np.float32)))
        return head
