"""Scores the selection by a word in the scene of a rendered clip, against the true object index, in original and new views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing

from f4x_core.clip.images import resize_nearest
from f4x_core.errors import F4xError
from f4x_core.evaluation.truth import SeenSurface, TrueClip
from f4x_core.geometry.camera import Camera
from f4x_core.priors.synthetic import read_passes
from f4x_core.progress import Progress, silent
from f4x_core.query.labels import Encode, TextQuery, ask_for
from f4x_core.query.pixels import coverage_image, text_score_map
from f4x_core.query.prompts import text_selection
from f4x_core.query.score import average_precision, overlap
from f4x_core.query.selection import Selection
from f4x_core.scene import Scene

View = tuple[Camera, float, np.ndarray, np.ndarray]
"""A camera in the scene's world, its clip time, (H,W) bool where the subject is, (H,W) bool where that is known."""


def score_labels(
    scene: Scene,
    truth_folder: Path | str,
    label: str,
    negatives: Sequence[str] | None = None,
    *,
    encode: Encode | None = None,
    progress: Progress = silent,
) -> dict[str, float]:
    """Compare what `label` selects with the moving subject of the rendered clip that `scene` was made from.

    Two classes, the subject and everything else; means over views. For the `original` views of all frames and, where the clip
    has extra cameras that the fitted path allows to place, the `novel` ones: `selection_accuracy_*`, `selection_miou_*`
    and `selection_ap_*` of the selection of the query, `argmax_accuracy_*` and `argmax_miou_*` of the best label at each
    pixel (`label` against `negatives`, the default ones when None). `known_fraction_*`: of the pixels that have a truth.

    Raises:
        F4xError: no truth there, or of another clip; a word that nobody knows.
    """
    query = ask_for(scene, [label], negatives, None, encode)
    selection = text_selection(scene, query)
    clip = TrueClip.read(scene, truth_folder)
    result: dict[str, float] = {}
    for kind, views in (("original", original_views), ("novel", novel_views)):
        rows: list[dict[str, float]] = []
        for view in views(scene, clip):
            progress(f"{kind} labels", len(rows), 0)
            rows.append(_score(scene, query, selection, view))
        if rows:
            result |= {f"{name}_{kind}": float(np.nanmean([row[name] for row in rows])) for name in rows[0]}
    return result


def _score(scene: Scene, query: TextQuery, selection: Selection, view: View) -> dict[str, float]:
    """Return the figures of one view, over its known pixels."""
    camera, time, subject, known = view
    truth = subject[known]
    best = text_score_map(scene, query, camera, time)
    found = {
        "selection": coverage_image(scene, selection, camera, time)[known] > 0.5,
        "argmax": ((best.argmax(-1) == 0) & (best[..., 0] > 0))[known],  # 0 where nothing is drawn
    }
    soft = coverage_image(scene, selection, camera, time, soft=True)[known]
    scores = {"selection_ap": average_precision(soft, truth), "known_fraction": float(known.mean())}
    for name, mask in found.items():
        scores[f"{name}_accuracy"] = float((mask == truth).mean())
        scores[f"{name}_miou"] = (overlap(mask, truth) + overlap(~mask, ~truth)) / 2
    return scores


def original_views(scene: Scene, clip: TrueClip) -> Iterator[View]:
    """Yield the clip's own views."""
    for frame, time in enumerate(scene.cameras.times):
        yield scene.cameras[frame], float(time), *_true_subject(scene, clip, clip.folder / "truth", frame)


def novel_views(scene: Scene, clip: TrueClip) -> Iterator[View]:
    """Yield the extra cameras' views; without passes of theirs, the truth is what the clip's frames saw (`subject_from`)."""
    size = scene.cameras.width, scene.cameras.height
    seen = None
    for extra in clip.extras:
        for index, time in enumerate(extra.cameras.times):
            camera = clip.into_scene(extra.cameras[index], scene)
            if extra.passes.is_dir():
                yield camera, float(time), *_true_subject(scene, clip, extra.passes, int(time))
                continue
            seen = seen or SeenSurface.read(clip.folder, clip.path, np.arange(len(clip.path)), clip.moving_index)
            if seen is None:
                raise F4xError(f"{clip.folder / 'truth'} is not complete; render the clip again.")
            subject, known = subject_from(seen, extra.cameras[index], int(time))
            yield camera, float(time), resize_nearest(subject, *size), resize_nearest(known, *size)


def _true_subject(scene: Scene, clip: TrueClip, passes: Path, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (H,W) bool where the object index says that the subject is, at the scene's size, and that all of it is known."""
    index = read_passes(passes / f"{frame:05d}.exr")["Object Index"]
    subject = resize_nearest(np.isin(index.round(), clip.moving_index), scene.cameras.width, scene.cameras.height)
    return subject, np.ones_like(subject)


def subject_from(seen: SeenSurface, camera: Camera, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (H,W) bool where `camera` of the true world sees what moves at `frame`, and (H,W) bool where a seen surface tells.

    Nearest of the true points that fall onto a pixel; gaps of single pixels between them are closed.
    """
    still = _nearest(camera, seen.still)
    moving = _nearest(camera, seen.moving[frame])
    closing = np.ones((3, 3))
    subject = binary_closing(np.pad(moving < still, 2), closing)[2:-2, 2:-2]
    known = binary_closing(np.pad(np.isfinite(np.minimum(still, moving)), 2, mode="edge"), closing)[2:-2, 2:-2]
    return subject, known | subject


def _nearest(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return (H,W) depth of the nearest of `points (P,3)` on each pixel, infinite where there is none."""
    pixels, depth = camera.project(points)
    column, row = np.floor(pixels).astype(int).T
    inside = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (row[inside], column[inside]), depth[inside])
    return nearest
