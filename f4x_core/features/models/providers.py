"""Priors providers that need models, offered to `priors` by name; nothing of them is imported before one is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...priors import register
from ...progress import Progress

if TYPE_CHECKING:
    from ...clip import Clip
    from ...priors import Priors, PriorsConfig


def offer_models() -> None:
    """From now on `DepthConfig(provider="depth-anything")` works."""
    register("depth", "depth-anything", _depth_anything)


def _depth_anything(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    from .depth import provide

    provide(clip, priors, config, progress)
