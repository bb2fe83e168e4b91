"""`f4x eval`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from ..clip import read_clip
from ..edit.apply import open_scene
from ..errors import F4xError
from ..evaluation.evaluate import Figures, evaluate, without_frames
from ..evaluation.perceptual_distance import lpips_missing
from ..evaluation.tracking import joint_accuracy
from ..evaluation.truth import score_against_truth
from ..printing import one_line
from ..progress import Progress
from ..reading import load_json, undamaged


def run_eval(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Measure a scene against its clip."""
    scene = open_scene(args.scene, args.edits)
    joints = _read_joints(args.joints) if args.joints is not None else None
    clip = read_clip(args.clip, frames=args.frames or scene.fitted_frames, width=scene.cameras.width, masks=args.masks)
    if joints is not None and clip.masks is None:
        raise F4xError("--joints needs --masks: the size of the animal sets how near a joint must be.")
    masks = None if clip.masks is None else dict(enumerate(clip.masks))
    result = evaluate(scene, clip, Figures(args.refine_camera, args.baselines, True, masks), args.backend, progress)
    if args.truth is not None:
        scores = score_against_truth(
            scene, args.truth, refine_camera=args.refine_camera, backend=args.backend, progress=progress
        )
        result |= {name: value for name, value in scores.items() if name != "views"}
    if joints is not None:
        assert clip.masks is not None
        areas = {index: float(mask.sum()) for index, mask in enumerate(clip.masks)}
        result |= joint_accuracy(scene, joints, areas, args.backend)
    lines = [f"{name}: {value:.3f}" for name, value in without_frames(result).items()]
    lines += lpips_missing()
    fitted = str(scene.provenance.get("source", ""))
    if fitted and Path(fitted).name != Path(clip.source).name:
        lines.insert(0, f"note: the scene was fitted from {one_line(fitted)}, not from {clip.source}")
    return {**result, "text": "\n".join(lines)}


def _read_joints(path: Path) -> Any:
    """Return the joints of a file as `joint_accuracy` takes them, each number checked; F4xError."""
    with undamaged(
        path, 'give hand-set joints: {"size": [W, H], "frames": [{"frame": 0, "joints": {"knee": [x, y]}}]}'
    ):
        data = load_json(path)
        frames: list[dict[str, Any]] = [
            {"frame": int(entry["frame"]), "joints": {name: _pair(place) for name, place in entry["joints"].items()}}
            for entry in data["frames"]
        ]
        if any(entry["frame"] < 0 for entry in frames):
            raise ValueError("a frame is negative")
        return {"size": _pair(data["size"]), "frames": frames}


def _pair(values: Any) -> tuple[float, float]:
    x, y = map(float, values)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"{values} are no two numbers")
    return x, y
