"""`f4x refit`, and the appearance for linear light of `f4x fit --linear-light`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..files import link_target, lock_file, neighbour
from ..fit.linear_config import LinearConfig
from ..fit.linear_light import agreement, refit
from ..progress import Progress
from ..scene import updating, write_scene
from .distilling import read_with_arrays, with_edits_since

PATIENCE = 60.0
"""Seconds to wait for another `f4x refit` of the same scene."""


def run_refit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Refit a scene for renderers that blend in linear light, in place."""
    config = LinearConfig(steps=args.steps, seed=args.seed, threads=args.threads or 0)
    return refit_file(args.scene, config, args.resume, progress)


def refit_file(path: Path, config: LinearConfig, resume: bool, progress: Progress) -> dict[str, Any]:
    """Refit the scene at `path` and write it; edits that others put into the file meanwhile stay. Returns the verb's result.

    It is held for minutes, so the lock is none of the scene's, as in `f4x distill`.
    """
    busy = f"{path}: another `f4x refit` is working on this scene; try again when it is done."
    with lock_file(neighbour(link_target(path), "refit-lock"), busy, PATIENCE):
        scene, arrays = read_with_arrays(path)
        before = agreement(scene)
        scene = refit(scene, config, neighbour(link_target(path), "refit"), resume, progress)
        after = agreement(scene)
        with updating(path):
            write_scene(with_edits_since(scene, path, arrays), path)
    figures = {"before_dB": float(np.mean(before)), "after_dB": float(np.mean(after)), "worst_dB": min(after)}
    text = (
        f"{path}: refitted for linear light. Drawn as Blender 5.3's Cycles draws, its pictures were {figures['before_dB']:.1f} dB"
        f" from its own and are {figures['after_dB']:.1f} now (worst {figures['worst_dB']:.1f})."
    )
    return {"scene": str(path), **figures, "text": text}
