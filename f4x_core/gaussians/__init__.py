"""Torch parameter sets of static and dynamic Gaussians, where they start, and how their number is controlled."""

from .density import DensityConfig, DensityControl
from .optimiser import SetOptimiser
from .parameters import DynamicGaussians, GaussianSet, StaticGaussians, appearance
from .spawn import SpawnConfig, Spawned, learnt_before, spawn_dynamic, spawn_static

__all__ = [
    "DensityConfig",
    "DensityControl",
    "DynamicGaussians",
    "GaussianSet",
    "SetOptimiser",
    "SpawnConfig",
    "Spawned",
    "StaticGaussians",
    "appearance",
    "learnt_before",
    "spawn_dynamic",
    "spawn_static",
]
