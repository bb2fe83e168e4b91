"""`f4x refit`."""

from __future__ import annotations

import argparse
from typing import Any

from ..app.refitting import Refitted, refit_file
from ..fit.linear_config import LinearConfig
from ..progress import Progress


def run_refit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Run `f4x refit`: refit a scene, in place, for renderers that blend in linear light."""
    config = LinearConfig(steps=args.steps, seed=args.seed, threads=args.threads or 0)
    return refitted_result(refit_file(args.scene, config, args.resume, progress))


def refitted_result(done: Refitted) -> dict[str, Any]:
    """Return the result of the verb."""
    figures = {"before_dB": done.before, "after_dB": done.after, "worst_dB": done.worst}
    text = (
        f"{done.path}: refitted for linear light. Drawn as Blender 5.3's Cycles draws, its pictures were {done.before:.1f} dB"
        f" from its own and are {done.after:.1f} now (worst {done.worst:.1f})."
    )
    return {"scene": str(done.path), **figures, "text": text}
