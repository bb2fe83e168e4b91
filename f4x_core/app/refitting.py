"""The appearance of a scene file for renderers that blend in linear light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import link_target, lock_file, neighbour
from ..fit.linear_config import LinearConfig
from ..fit.linear_light import agreement, refit
from ..progress import Progress, silent
from ..scene import updating, write_scene
from .distilling import read_with_arrays, with_edits_since

PATIENCE = 60.0
"""Seconds to wait for another program that refits the same scene."""


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
    """Refit the scene at `path` and write it, as `f4x refit` does; edits that others put into the file meanwhile stay.

    It is held for minutes, so the lock is none of the scene's, as in `distilling.only_distiller`.
    """
    busy = f"{path}: another `f4x refit` is working on this scene; try again when it is done."
    with lock_file(neighbour(link_target(path), "refit-lock"), busy, PATIENCE):
        scene, arrays = read_with_arrays(path)
        before = agreement(scene)
        scene = refit(scene, config, neighbour(link_target(path), "refit"), resume, progress)
        after = agreement(scene)
        with updating(path):
            write_scene(with_edits_since(scene, path, arrays), path)
    return Refitted(path, float(np.mean(before)), float(np.mean(after)), min(after))
