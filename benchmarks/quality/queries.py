"""Scores queries of a scene: text scores and followed masks against true masks, and the cost of features."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from f4x_core.progress import Progress, silent
from f4x_core.query.labels import Encode, ask_for
from f4x_core.query.pixels import coverage_image, head_map, text_score_map
from f4x_core.query.prompts import SelectOptions, select_by_mask, text_selection
from f4x_core.query.score import average_precision, overlap, select
from f4x_core.query.smoothing import LOOKS_ALIKE, field_of_looks
from f4x_core.scene import Scene
from f4x_core.scene.view import render

FOLLOWED = (5, 10, 30)
"""Frames at which a followed mask is measured, besides the last."""


def score_text(
    scene: Scene, masks: Mapping[int, np.ndarray], label: str, encode: Encode | None = None, progress: Progress = silent
) -> dict[str, float]:
    """Score the query for `label` against bool `masks` (frame -> (H,W)) in the original views; means over frames with a mask.

    Average precision: `text_ap` of decoded rendered latents, `text_gaussians_ap` of the selection's composited scores. IoU:
    `text_iou` of the selection, `text_rule_iou` of Feature4X's rule (`score.select`) on decoded rendered latents.
    """
    query = ask_for(scene, [label], None, None, encode)
    single = text_selection(scene, query)
    rows = []
    for done, (frame, mask) in enumerate(masks.items()):
        progress("text", done, len(masks))
        if not mask.any():
            continue
        camera, time = scene.cameras[frame], float(scene.cameras.times[frame])
        scores = text_score_map(scene, query, camera, time)
        soft = coverage_image(scene, single, camera, time, soft=True)
        chosen = coverage_image(scene, single, camera, time) > 0.5
        ruled = select(scores, 0) & (scores[..., 0] > 0)  # 0 where nothing is drawn
        rows.append(
            (
                average_precision(scores[..., 0], mask),
                average_precision(soft, mask),
                overlap(chosen, mask),
                overlap(ruled, mask),
            )
        )
    means = np.mean(rows, 0) if rows else [np.nan] * 4
    names = ("text_ap", "text_gaussians_ap", "text_iou", "text_rule_iou")
    return dict(zip(names, map(float, means), strict=True))


def score_following(scene: Scene, masks: Mapping[int, np.ndarray], progress: Progress = silent) -> dict[str, float]:
    """IoU of the 4D selection that the first frame's mask gives, in the original view: `follow_iou_T` and their mean."""
    first = min(masks)
    selection = select_by_mask(scene, masks[first], first, SelectOptions(progress=progress))
    result = {}
    for frame in sorted({*(t for t in FOLLOWED if t in masks), max(masks)}):
        weights = coverage_image(scene, selection, scene.cameras[frame], float(scene.cameras.times[frame]))
        result[f"follow_iou_{frame}"] = overlap(weights > 0.5, masks[frame])
    return result


def measure_cost(scene: Scene, repeats: int = 5) -> dict[str, float]:
    """Megabytes of file with and without the field, and the milliseconds of a frame: pictures, and each head on its grid."""
    sizes = scene.info()["megabytes"]
    features = sizes.get("features", 0.0)
    plain = sum(sizes.values()) - features
    camera, time = scene.cameras[0], float(scene.cameras.times[0])
    jobs: dict[str, Callable[[], Any]] = {"rgb": partial(render, scene, camera, time, ("rgb",))}
    for name in scene.features.names if scene.features is not None else ():
        jobs[name] = partial(head_map, scene, name, camera, time)
    took: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():  # interleaved: other load on the machine hits all alike
            start = clock.perf_counter()
            job()
            took[name].append(1e3 * (clock.perf_counter() - start))
    return {"size_ratio": (plain + features) / max(plain, 1e-9)} | {f"{n}_ms": median(v) for n, v in took.items()}


def benchmark(
    scene: Scene,
    masks: Mapping[int, np.ndarray],
    label: str | None = None,
    encode: Encode | None = None,
    repeats: int = 5,
    progress: Progress = silent,
) -> dict[str, Any]:
    """All figures of one scene with true `masks` (clip frame -> (H,W) bool); `label` names what they show."""
    report: dict[str, Any] = {"scene": scene.name, "frames": len(masks), "label": label}
    report["follows_by"] = "stand-in" if field_of_looks(scene) is None else LOOKS_ALIKE
    if label is not None:
        report |= score_text(scene, masks, label, encode, progress)
    return report | score_following(scene, masks, progress) | measure_cost(scene, repeats)
