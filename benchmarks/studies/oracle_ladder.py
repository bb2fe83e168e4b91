"""The oracle ladder: rendered clips fitted to true priors of which one after the other is replaced by the offline one.

What a replacement costs on surfaces that the clip saw, in views that it never had, is what a better prior of that kind
could win at most. The other way round, all priors offline but one, is what it would win today.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from f4x_core.clip import Clip, read_clip
from f4x_core.evaluation.truth import align_cameras, depth_errors, score_against_truth
from f4x_core.fit.config import FitConfig
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig, build_priors
from f4x_core.priors.depth import MAX_DEPTH
from f4x_core.priors.synthetic import motion_of_tracks
from f4x_core.scene import Scene

from ..halves import PEOPLE, RENDERED
from ..study import Context, Findings, Row, Table
from .clip_studies import PEOPLE_RENDER, render_clips
from .toy_fits import QUICK_STEPS, base_config, shorten

RUNGS = ("camera poses", "focal length", "depth of the background", "depth of moving objects", "tracks", "masks")
"""Priors that are replaced, alone and together."""
Mixture = tuple[str, frozenset[str]]
"""Label of the row, and the replaced ones of `RUNGS`."""
QUICK_CLIPS = ("procedural", "horizon")
"""Clips of a quick report: a room, and a far ground under a sky."""
STEPS = QUICK_STEPS
"""Steps of every fit."""
ANGLE = 10
"""Degrees off the path of the views that are compared."""
PICTURES = f"unseen_psnr_covered_at_{ANGLE}"
FIGURES = {
    "seen surfaces (dB)": PICTURES,
    "moving (dB)": f"unseen_psnr_covered_moving_at_{ANGLE}",
    "static (dB)": f"unseen_psnr_covered_static_at_{ANGLE}",
    "used (dB)": "used_psnr",
    "cameras, fraction of the path": "ate_fraction",
    "focal length, fitted / true": "focal_ratio",
    "depth error, static": "depth_error_static",
    "depth error, moving": "depth_error_moving",
}
"""Column -> what `score_against_truth` calls it."""
LOST = {"seen surfaces (dB)": "lost (dB)", "moving (dB)": "lost, moving (dB)", "static (dB)": "lost, static (dB)"}
"""Figure -> column of its loss against all priors true."""


def study_ladder(context: Context) -> Findings:
    """Every rung alone, all together, and all but one, on all rendered clips."""
    clips, skipped = render_clips(context, context.choose(QUICK_CLIPS, RENDERED.every))
    if not context.quick:
        people, without = render_clips(context, PEOPLE.every, PEOPLE_RENDER)
        clips, skipped = clips | people, skipped + without
    rows: list[Row] = []
    errors: list[Row] = []
    steps = context.choose(mixtures()[: len(RUNGS) + 2], mixtures())
    config = shorten(base_config(context), STEPS)  # what one prior costs shows early
    for name, folder in clips.items():
        found = context.step(name, partial(climb, folder, context.folder / name, config, steps))
        about = {"clip": name, "half": RENDERED.half_of(name) or PEOPLE.half_of(name)}
        rows += [about | row for row in found["rungs"]]
        errors.append(about | found["priors"])
    note = (
        f"Profile quick in {STEPS} steps. Seen surfaces of views {ANGLE} degrees off the path, parted by what the pixel truly"
        " shows; lost: against the same fit with every prior true. Offline depth replaced alone is scaled by the median ratio"
        " over the background, offline cameras by their similarity to the true ones; both keep their own unit where both are"
        " offline."
    )
    tables = [
        Table("ladder", rows, "True priors replaced by offline ones", note=note),
        Table("priors", errors, "How wrong the offline priors are"),
    ]
    return Findings(tables, words=_words(rows), skipped=skipped)


def climb(clip_folder: Path, work: Path, config: FitConfig, steps: Sequence[Mixture]) -> Row:
    """Fit one rendered clip to each mixture of `steps`, whose first replaces nothing; priors are kept below `work`.

    Returns `rungs`, a row for each, and `priors`, errors of the offline ones.
    """
    clip = read_clip(clip_folder / "images")
    true = build_priors(clip, work / "true", PriorsConfig.of("synthetic"))
    offline = build_priors(clip, work / "offline", config.priors)
    rows: list[Row] = []
    for label, replaced in steps:
        scene = fit_priors(clip, mix_priors(true, offline, replaced), config)
        scores = score_against_truth(scene, clip_folder, backend=config.backend) | dict(scene.metrics)
        row: Row = {"offline": label} | {column: scores.get(name) for column, name in FIGURES.items()}
        rows.append(row | _losses(row, rows))
    return {"rungs": rows, "priors": prior_errors(true, offline)}


def mixtures() -> list[Mixture]:
    """Label and replaced rungs: none first, each alone, all, then all but one."""
    alone = [(rung, frozenset({rung})) for rung in RUNGS]
    but_one = [(f"all but {rung}", frozenset(RUNGS) - {rung}) for rung in RUNGS]
    return [("none", frozenset()), *alone, ("all", frozenset(RUNGS)), *but_one]


def mix_priors(true: Priors, offline: Priors, replaced: Collection[str]) -> Priors:
    """`true` with the `replaced` ones of `RUNGS` taken from `offline`, in the unit of the true world.

    Priors of one clip, of the same frames and size, complete; nothing of either is changed.
    """
    if set(replaced) == set(RUNGS):
        return offline
    wanted = {rung: rung in replaced for rung in RUNGS}
    shown = offline if wanted["masks"] else true
    tracks = offline if wanted["tracks"] else true
    if wanted["masks"] and wanted["tracks"]:
        motion = offline.tracks_motion
    else:
        motion = motion_of_tracks(_array(tracks.tracks), _array(tracks.tracks_visible), _array(shown.mask))
    depth, confidence = _mixed_depth(true, offline, wanted)
    cameras, from_cameras = _mixed_cameras(true, offline, wanted)
    return replace(
        true,
        cameras=cameras,
        camera_kind=from_cameras.camera_kind,
        depth=depth,
        depth_confidence=confidence,
        mask=shown.mask,
        motion=shown.motion,
        people=shown.people,
        people_probability=shown.people_probability,
        people_joints=shown.people_joints,
        people_metres=shown.people_metres,
        tracks=tracks.tracks,
        tracks_visible=tracks.tracks_visible,
        tracks_motion=motion,
    )


def _mixed_cameras(true: Priors, offline: Priors, wanted: dict[str, bool]) -> tuple[CameraPath, Priors]:
    """Poses of one of the two with the focal length of one of them, and whose poses they are."""
    assert true.cameras is not None and offline.cameras is not None
    ours = offline.cameras.scaled_world(align_cameras(offline.cameras, true.cameras)[0])
    poses = ours if wanted["camera poses"] else true.cameras
    lens = ours if wanted["focal length"] else true.cameras
    mixed = CameraPath(lens.intrinsics, poses.world_to_camera, poses.times, poses.width, poses.height)
    return mixed, offline if wanted["camera poses"] else true


def _mixed_depth(true: Priors, offline: Priors, wanted: dict[str, bool]) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its confidence, replaced where the true mask is (`depth of moving objects`) or is not."""
    assert true.cameras is not None and offline.cameras is not None
    moving = _array(true.mask)
    if wanted["camera poses"] and wanted["depth of the background"]:
        scale = align_cameras(offline.cameras, true.cameras)[0]  # they fit each other: one world, one unit
    else:
        scale = static_depth_scale(true, offline)
    taken = np.where(moving, wanted["depth of moving objects"], wanted["depth of the background"])
    depth = np.where(taken, np.float32(scale) * _array(offline.depth), _array(true.depth))
    return depth, np.where(taken, _array(offline.depth_confidence), _array(true.depth_confidence))


def static_depth_scale(true: Priors, offline: Priors) -> float:
    """Median over the background, sky left out, of true depth / offline depth."""
    ratio = (_array(true.depth) / _array(offline.depth))[~_array(true.mask) & (_array(true.depth) < MAX_DEPTH)]
    return float(np.median(ratio[np.isfinite(ratio)]))


def prior_errors(true: Priors, offline: Priors) -> Row:
    """Errors of the offline priors: depth in the unit of the cameras' alignment and in its own, focal length, masks."""
    assert true.cameras is not None and offline.cameras is not None
    moving, ours, row = _array(true.mask), _array(offline.depth), Row()
    surfaces = np.where(_array(true.depth) < MAX_DEPTH, _array(true.depth), np.inf)
    for unit, scale in (
        ("unit by cameras", align_cameras(offline.cameras, true.cameras)[0]),
        ("unit by depth", static_depth_scale(true, offline)),
    ):
        for name, error in depth_errors(scale * ours, surfaces, moving).items():
            row[f"{name.replace('_', ' ')}, {unit}"] = error
    found = _array(offline.mask)
    row["masks, IoU"] = float((found & moving).sum() / max((found | moving).sum(), 1))
    row["focal length, offline / true"] = float(
        np.median(offline.cameras.intrinsics[:, 0, 0] / true.cameras.intrinsics[:, 0, 0])
    )
    return row | {"camera": offline.camera_kind}


def fit_priors(clip: Clip, priors: Priors, config: FitConfig) -> Scene:
    """Fit `clip` to `priors` that are in memory; `metrics` of the scene hold `used_psnr`."""
    from f4x_core.evaluation.evaluate import evaluate, without_frames

    torch.set_num_threads(config.threads or 1)
    trainer = start_fit(clip, priors, config)
    trainer.run()
    scene = finish_fit(trainer).scene
    return replace(scene, metrics=without_frames(evaluate(scene, clip, backend=config.backend)))


def _array(values: np.ndarray | None) -> np.ndarray:
    """Return a prior that complete priors have."""
    assert values is not None
    return values


def _losses(row: Row, before: Sequence[Row]) -> Row:
    """Losses of the row against the first one, by `LOST`; None where either is not measured."""
    first = before[0] if before else row
    return {
        lost: None if row[figure] is None or first[figure] is None else first[figure] - row[figure]
        for figure, lost in LOST.items()
    }


def _words(rows: Sequence[Row]) -> list[str]:
    """Sentences per clip: which prior costs most alone, and what all cost together."""
    words = []
    for clip in dict.fromkeys(row["clip"] for row in rows):
        lost = {row["offline"]: row["lost (dB)"] for row in rows if row["clip"] == clip}
        alone = {rung: lost[rung] for rung in RUNGS if lost.get(rung) is not None}
        if alone and lost.get("all") is not None:
            worst = max(alone, key=lambda rung: alone[rung])
            words.append(
                f"{clip}: all priors offline cost {lost['all']:.1f} dB on seen surfaces {ANGLE} degrees off the path;"
                f" alone, {worst} cost most, {alone[worst]:.1f} dB."
            )
    return words
