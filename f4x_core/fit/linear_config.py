"""Settings of a refit for linear light. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import F4xError


@dataclass(frozen=True)
class LinearConfig:
    """Settings of a refit."""

    steps: int = 600
    """Optimiser steps; each draws a part of one picture."""
    scale_rate: float = 0.02
    """Adam's rate of the logarithms of scales."""
    opacity_rate: float = 0.05
    """Adam's rate of the logits of opacities."""
    color_rate: float = 0.02
    """Adam's rate of colours, display values from 0 to 1."""
    last_rate: float = 0.1
    """Factor of the rates at the last step; they fall exponentially."""
    part: float = 0.5
    """Sides of the part of a picture that a step draws, relative to the whole."""
    oversample: int = 2
    """Rays for each pixel along an axis: what several Gaussians do within a pixel counts."""
    aside: float = 8.0
    """Degrees by which every second view is swung about the scene's centre, at most."""
    save_every: int = 100
    """Steps between checkpoints."""
    seed: int = 0
    """Seed of the choice of views."""
    threads: int = 0
    """Worker threads; 0 = all cores. Never changes the result."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.steps < 1:
            raise F4xError(f"--steps {self.steps}: give a number above 0.")
