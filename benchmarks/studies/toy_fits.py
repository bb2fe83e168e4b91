"""Fits of toy worlds with true priors, and how far they are from the truth: what the studies of the fit are made of."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from f4x_core.evaluation.perceptual_distance import lpips, lpips_missing
from f4x_core.evaluation.tracking import track_pixels
from f4x_core.evaluation.truth import align_cameras, into_scene
from f4x_core.fit.config import FitConfig, profile
from f4x_core.fit.model import SceneModel
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.fit.trainer import FitStart, Trainer
from f4x_core.geometry.camera import Camera
from f4x_core.metrics.pictures import psnr, ssim
from f4x_core.priors import Priors
from f4x_core.scene import Scene
from f4x_core.scene.view import render

from ..study import Context, Row, span_columns
from .toy_worlds import View, World, make_world

QUICK_STEPS = 160
"""Steps of a fit in a quick report."""
QUICK_SIZE, FULL_SIZE = (96, 16), (160, 16)
"""Width and frames of the worlds' clips: a full report makes some five hundred fits of them in a night."""
TRACKED = 120
"""Most true tracks that are followed."""
NOTE = (
    "Toy worlds: true priors; novel views look from 4 degrees aside of the path and 3 above it, after the fitted path was laid"
    " upon the true one as a whole; `moving` counts pixels that show what moves. The world itself has error 0."
)
"""For tables of these errors."""


def toy_world(context: Context, name: str) -> World:
    """Return the world called `name` at the report's size."""
    return make_world(name, *context.choose(QUICK_SIZE, FULL_SIZE))


@dataclass(frozen=True)
class Fitted:
    """A scene and what it cost."""

    scene: Scene
    seconds: dict[str, float]
    """Wall time of `start` and `photometric`."""


def base_config(context: Context, **changes: Any) -> FitConfig:
    """Return the `quick` profile, with fewer steps in a quick report."""
    config = replace(profile("quick"), threads=context.threads, seed=context.seed)
    return replace(config if not context.quick else shorten(config, QUICK_STEPS), **changes)


def shorten(config: FitConfig, steps: int) -> FitConfig:
    """The same schedule in `steps` steps: what happens every so many steps happens as often."""
    fraction = steps / config.steps
    static, dynamic = (
        replace(control, every=max(round(fraction * control.every), 1))
        for control in (config.density_static, config.density_dynamic)
    )
    settling, following = (
        round(fraction**0.5 * count) for count in (config.scaffold.geometry_steps, config.scaffold.following_steps)
    )
    scaffold = replace(config.scaffold, geometry_steps=settling, following_steps=following)
    return replace(
        config,
        steps=steps,
        scaffold=scaffold,
        graph_every=max(round(fraction * config.graph_every), 1),
        measure_every=steps,
        density_static=static,
        density_dynamic=dynamic,
    )


def thin_out(config: FitConfig, factor: float) -> FitConfig:
    """The same with `factor` times as many Gaussians per area, at the start and at the limit."""
    changes: dict[str, Any] = {}
    for name in ("static", "dynamic"):
        spawn, density = getattr(config, f"spawn_{name}"), getattr(config, f"density_{name}")
        changes[f"spawn_{name}"] = replace(spawn, spacing=spawn.spacing / factor**0.5)
        changes[f"density_{name}"] = replace(
            density, max_count=max(round(density.max_count * factor), density.min_count)
        )
    return replace(config, **changes)


def fit_world(
    world: World, config: FitConfig, priors: Priors | None = None, model: type[SceneModel] | None = None
) -> Fitted:
    """Fit the world's clip to its true priors, or to `priors`.

    `model` trains another kind of scene in the place of the usual one, started from the same Gaussians.
    """
    torch.set_num_threads(config.threads or 1)
    clip, priors = world.clip, priors or world.priors
    clock = time.perf_counter()
    trainer = start_fit(clip, priors, config)
    if model is not None:
        old = trainer.model
        other = model(old.static, old.dynamic, old.nodes, old.rig, old.kernel)
        trainer = Trainer(other, clip, trainer.priors, config, FitStart(trainer.next_id, trainer.needs))
    started = time.perf_counter()
    trainer.run()
    seconds = {"start": started - clock, "photometric": time.perf_counter() - started}
    return Fitted(finish_fit(trainer, seconds).scene, seconds)


def score_world(world: World, scene: Scene) -> Row:
    """Errors of a scene against the truth.

    Novel views: `novel_views`; `moving` counts only pixels that truly show what moves; LPIPS where it runs. Tracks:
    median distance in pixels between where true points go, from the first frame that sees them, and where the scene says.
    """
    novel = [(render_of(scene, camera, moment), view) for camera, moment, view in novel_views(world, scene)]
    moving = [_psnr(image, view, view.moving > 0.5) for image, view in novel if (view.moving > 0.5).any()]
    clip = [_psnr(render_of(scene, scene.cameras[i], float(i)), view) for i, view in enumerate(world.views)]
    held_out = np.isin(np.arange(len(clip)), scene.held_out)
    perceived = [far for image, view in novel if (far := lpips(image.numpy(), view.rgb)) is not None]
    return {
        "novel (dB)": float(np.mean([_psnr(*pair) for pair in novel])),
        "novel SSIM": float(np.mean([ssim(image, torch.from_numpy(view.rgb)) for image, view in novel])),
        **({"novel LPIPS": float(np.mean(perceived))} if perceived else {}),
        "novel, moving (dB)": float(np.mean(moving)) if moving else None,
        "held out (dB)": float(np.mean(np.array(clip)[held_out])),
        "used (dB)": float(np.mean(np.array(clip)[~held_out])),
        "track (px)": track_error(world, scene) if moving else None,
        "Gaussians": len(scene.static) + len(scene.dynamic),
        "nodes": 0 if scene.scaffold is None else len(scene.scaffold),
    }


def novel_views(world: World, scene: Scene) -> list[tuple[Camera, float, View]]:
    """Camera of the scene's world, time, and truth of the views `NOVEL_DEGREES` off the clip's path.

    Fits refine their cameras, and no picture tells if all of them are turned, moved and farther apart together with the world
    (a gauge); the used cameras are therefore laid upon the true ones as a whole first, as is usual where cameras are found.
    """
    used = world.clip.supervised.astype(float)
    similarity = align_cameras(scene.cameras.at_times(used), world.cameras.at_times(used))
    return [(into_scene(camera, similarity), moment, view) for camera, moment, view in world.novel_views]


def measure(
    world: World, config: FitConfig, priors: Priors | None = None, model: type[SceneModel] | None = None
) -> Row:
    """Fit and score: the errors, and `fit (s)`."""
    fitted = fit_world(world, config, priors, model)
    return score_world(world, fitted.scene) | {"fit (s)": sum(fitted.seconds.values())}


def each_seed(context: Context, name: str, work: Callable[[int], Row], count: int, **settings: Any) -> list[Row]:
    """Return the results of `work(seed)` for `count` seeds, a step each."""
    seeds = range(context.seed, context.seed + count)
    settings |= {} if lpips_missing() else {"lpips": True}  # `score_world` has one column more
    return [context.step(f"{name} {seed}", partial(work, seed), **settings) for seed in seeds]


def mean_row(rows: Sequence[Row], error: str = "novel (dB)") -> Row:
    """Means over seeds; what is no number is the first's.

    Of column `error` there are also the worst and the best: `novel low (dB)`, `novel high (dB)`.
    """
    means = {column: _mean([row[column] for row in rows]) for column in rows[0]}
    return means | spread(error, [row[error] for row in rows]) | {"seeds": len(rows)}


def spread(column: str, values: Sequence[float]) -> Row:
    """Return the least and the greatest value under `NAME low (unit)` and `NAME high (unit)` for column `NAME (unit)`."""
    return dict(zip(span_columns(column), (min(values), max(values)), strict=True))


def paired_changes(rows: Sequence[Row], against: Sequence[Row], column: str) -> list[float]:
    """Differences of rows with the same seed, for the seeds that both have."""
    return [row[column] - other[column] for row, other in zip(rows, against, strict=False)]


def _mean(values: list[Any]) -> Any:
    numbers = all(isinstance(value, (int, float)) for value in values)
    return statistics.fmean(values) if numbers and len(set(values)) > 1 else values[0]


def _psnr(image: torch.Tensor, view: View, mask: np.ndarray | None = None) -> float:
    """PSNR (dB) against the truth, over `mask` (H,W) bool where given."""
    weight = None if mask is None else torch.from_numpy(mask.astype(np.float32))
    return psnr(image, torch.from_numpy(view.rgb), weight)


def render_of(scene: Scene, camera: Camera, moment: float) -> torch.Tensor:
    """Return (H,W,3) what the scene shows, in [0,1]."""
    return torch.from_numpy(np.clip(render(scene, camera, moment, ("rgb",))["rgb"], 0, 1))


def track_error(world: World, scene: Scene) -> float:
    """Median distance (pixels) between true and followed points that move."""
    pixels, visible, moving = world.tracks
    first = visible[:, moving].argmax(0)
    pixels, visible = pixels[:, moving], visible[:, moving]
    start = int(np.bincount(first[visible.any(0)]).argmax())
    chosen = np.flatnonzero(visible[start])
    chosen = chosen[:: max(1, len(chosen) // TRACKED)]
    targets = [t for t in range(0, world.frames, 3) if t != start]
    found = track_pixels(scene, start, pixels[start, chosen], targets)  # (targets,Q,2)
    seen = visible[targets][:, chosen]
    return float(np.median(np.linalg.norm(found - pixels[targets][:, chosen], axis=-1)[seen]))
