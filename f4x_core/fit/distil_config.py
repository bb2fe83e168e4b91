"""The settings of distillation. Torch-free: the command line shows their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class DistilConfig:
    """Settings of distilling features into a scene."""

    width: int | None = None
    """D, channels of the latent; even, because two share a byte. None asks the spectrum of the teachers for one of its `WIDTHS`."""
    steps: int = 600
    """Optimiser steps."""
    frames_per_step: int = 2
    """Frames that one step looks at."""
    latent_rate: float = 0.02
    """Adam's rate of latents, whose spread is about 1; falls along a cosine."""
    head_rate: float = 3e-3
    """Adam's rate of the heads; falls along a cosine."""
    ssim: float = 0.1
    """Weight of 1 - SSIM of the feature maps beside their relative L1."""
    ssim_channels: int = 64
    """A head with more channels has no SSIM term: it costs more there than the head itself."""
    cosine: float = 0.0
    """Weight of 1 - cosine between features, for heads that are read by direction."""
    head_weights: Mapping[str, float] | None = None
    """Weight of single heads in the loss by name; 1 where not named."""
    keep: float = 1.0
    """Weight of what the heads that the scene already has decode: the latent may move only where they do not see it. With
    `math.inf` the latent does not move at all."""
    feature_grad_to_skinning: bool = False
    """Let features also move the skinning weights. Motion, and with it the picture, then changes."""
    seed: int = 0
    """Seed of everything random."""
    threads: int | None = None
    """Threads of the raster; None: all cores."""
    backend: str = "auto"
    """Raster backend."""
    bits: int = 4
    """Bits per channel of a stored latent, 4 or 8: a cell is the mean of so many Gaussians that rounding averages out."""
