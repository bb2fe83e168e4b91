"""The appearance of a scene file for renderers that blend in linear light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import link_target, neighbour
from ..fit.linear_config import LinearConfig
from ..fit.linear_light import agreement, refit
from ..progress import Progress, silent
from ..scene.locking import only_run
from .distilling import OpenScene


@dataclass(frozen=True)
class Refitted:
    """PSNR (dB) of pictures drawn in linear light against those of the scene."""

    path: Path
    """The scene file."""
    before: float
    """Mean before the refit."""
    after: float
    """Mean after it."""
    worst: float
    """PSNR of the worst view after it."""


def refit_file(path: Path, config: LinearConfig, resume: bool = False, progress: Progress = silent) -> Refitted:
    """Refit the scene at `path` and write it, as `f4x refit` does; edits that others put into the file meanwhile stay."""
    with only_run("refit", path):
        opened = OpenScene.read(path)
        before = agreement(opened.scene)
        scene = refit(opened.scene, config, neighbour(link_target(path), "refit"), resume, progress)
        after = agreement(scene)
        opened.write(scene)
    return Refitted(path, float(np.mean(before)), float(np.mean(after)), min(after))
