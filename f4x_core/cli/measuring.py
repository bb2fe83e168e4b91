"""`f4x eval`."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..clip import read_clip
from ..errors import F4xError
from ..progress import Progress
from ..report.evaluation import evaluate
from ..report.tracking import joint_accuracy
from ..report.truth import score_against_truth
from ..scene import read_scene


def run_eval(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Measure a scene against its clip."""
    scene = read_scene(args.scene)
    clip = read_clip(args.clip, frames=args.frames, width=scene.cameras.width, masks=args.masks)
    result = evaluate(
        scene,
        clip,
        refine_camera=args.refine_camera,
        baselines=args.baselines,
        backend=args.backend,
        progress=progress,
    )
    if args.truth is not None:
        result |= {k: v for k, v in score_against_truth(scene, args.truth, args.backend, progress).items() if k != "views"}
    if args.joints is not None:
        if clip.masks is None:
            raise F4xError("--joints needs --masks: the size of the animal sets how near a joint must be.")
        areas = {index: float(mask.sum()) for index, mask in enumerate(clip.masks)}
        result |= joint_accuracy(scene, json.loads(args.joints.read_text()), areas, args.backend)
    lines = [f"{name}: {value:.3f}" for name, value in result.items() if name != "frames"]
    return {**result, "text": "\n".join(lines)}
