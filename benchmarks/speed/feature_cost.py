"""Cost of a feature field: none in the picture, and time on top of the fit."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import torch

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.features.maps import FeatureMaps
from f4x_core.features.teachers import TEACHERS
from f4x_core.fit.distil import distil
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.metrics.pictures import psnr
from f4x_core.progress import Progress, silent
from f4x_core.query.pixels import head_map
from f4x_core.query.score import overlap
from f4x_core.query.segmentation import FeaturePropagation
from f4x_core.scene import Scene
from f4x_core.scene.view import render

from .raster import compare_decoding

T = TypeVar("T")
WIDTHS = 32, 512
"""The latent of the project, and one as wide as a text encoder's space, between which Feature4X compares."""
SEED_RATIO = 5.23
"""Training time with 512 channels / with 32 that Feature4X reports (table D of its supplement: 14.80 h / 2.83 h)."""


def compare_renders(
    scene: Scene, plain: Scene, clip: Clip, backend: str = "auto", progress: Progress = silent
) -> dict[str, float]:
    """PSNR (dB) against all frames of `clip`: of `scene` drawn together with its latent, and of `plain`, without features.

    Returns `psnr`, `psnr_plain`, their difference `psnr_change`, and `psnr_change_most`, the largest |change| of a frame.
    Errors: F4xError when clip and scenes differ in frames or size.
    """
    for each in (scene, plain):
        cameras = each.cameras
        if (len(cameras), cameras.width, cameras.height) != (len(clip), clip.width, clip.height):
            raise F4xError(
                f"{clip.source}: the clip has {len(clip)} frames of {clip.width}x{clip.height}, the scene {each.name}"
                f" {len(cameras)} of {cameras.width}x{cameras.height}; give the clip that it was fitted to."
            )
    scores = []
    for frame in range(len(clip)):
        progress("pictures", frame, len(clip))
        target = torch.from_numpy(clip.frames[frame].astype(np.float32) / 255)
        row = []
        for each, channels in ((scene, ("rgb", "latent")), (plain, ("rgb",))):
            moment = float(each.cameras.times[frame])
            image = render(each, each.cameras[frame], moment, channels, backend)["rgb"]
            row.append(psnr(torch.from_numpy(np.clip(image, 0, 1)), target))
        scores.append(row)
    full, without = np.array(scores).T
    return {
        "psnr": float(full.mean()),
        "psnr_plain": float(without.mean()),
        "psnr_change": float(full.mean() - without.mean()),
        "psnr_change_most": float(np.abs(full - without).max()),
    }


def measure_times(
    fit: Callable[[], Scene],
    maps: Sequence[FeatureMaps],
    config: DistilConfig,
    repeats: int = 1,
    progress: Progress = silent,
) -> dict[str, float]:
    """Wall seconds of `fit`, and of distilling `maps` into its scene with each of `WIDTHS`; geometry is not fitted again.

    `fit_ratio` is (fit + narrow) / fit, `width_ratio` (fit + wide) / (fit + narrow), `distil_ratio` wide / narrow alone.
    `step_ratio` is what the seed's way would pay: latents in every step of the fit, all wide channels drawn against narrow
    ones drawn and decoded, forward and backward.
    """
    scene, seconds = _timed(fit)
    took = {}
    for width in WIDTHS:
        settings = DistilConfig(width, config.steps, seed=config.seed, threads=config.threads, backend=config.backend)
        took[width] = _timed(lambda settings=settings: distil(scene, maps, settings, progress))[1]  # type: ignore[misc]
    narrow, wide = (took[width] for width in WIDTHS)
    return {
        "fit_seconds": seconds,
        **{f"distil_seconds_{width}": took[width] for width in WIDTHS},
        "fit_ratio": (seconds + narrow) / seconds,
        "width_ratio": (seconds + wide) / (seconds + narrow),
        "width_ratio_seed": SEED_RATIO,
        "distil_ratio": wide / narrow,
        "step_ratio": compare_decoding(repeats=repeats, backend=config.backend)["ratio"],
    }


def compare_inference(
    scene: Scene,
    mask: np.ndarray,
    frame: int = 0,
    teacher: str = "visual",
    backend: str = "auto",
    progress: Progress = silent,
) -> dict[str, float]:
    """Wall seconds of carrying `mask (H,W)` on clip frame `frame` to every frame by the scene's own features, and by pictures.

    `mask_feature_seconds`: the head's maps are rendered; `mask_picture_seconds`: RGB is rendered and the teacher encodes it; both
    then follow the mask in the same way, and alternate frame by frame. `mask_time_ratio` is pictures / features.
    `mask_agreement` is the mean IoU of the two. Errors: F4xError without that head, or without the teacher's weights.
    """
    scene.require_field([teacher])
    cameras = scene.cameras
    encoder = TEACHERS[teacher].load(None)
    encoder.encode(np.zeros((cameras.height, cameras.width, 3), np.uint8))  # a first call prepares itself

    def by_features(t: int) -> np.ndarray:
        return head_map(scene, teacher, cameras[t], float(cameras.times[t]), backend)

    def by_images(t: int) -> np.ndarray:
        image = render(scene, cameras[t], float(cameras.times[t]), ("rgb",), backend)["rgb"]
        return encoder.encode((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))

    ways = [
        FeaturePropagation(source, len(cameras), (cameras.height, cameras.width)) for source in (by_features, by_images)
    ]
    seconds = [0.0, 0.0]
    for index, way in enumerate(ways):
        seconds[index] += _timed(lambda way=way: way.prompt(frame, mask=mask))[1]  # type: ignore[misc]
    steps, shared = [way.propagate() for way in ways], []
    for done in range(len(cameras)):
        progress("masks", done, len(cameras))
        found = []
        for index, step in enumerate(steps):
            (_, logits), took = _timed(lambda step=step: next(step))  # type: ignore[misc]
            seconds[index] += took
            found.append(logits > 0)
        shared.append(overlap(*found))
    return {
        "mask_feature_seconds": seconds[0],
        "mask_picture_seconds": seconds[1],
        "mask_time_ratio": seconds[1] / seconds[0],
        "mask_agreement": float(np.mean(shared)),
    }


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    start = time.perf_counter()
    return work(), time.perf_counter() - start
