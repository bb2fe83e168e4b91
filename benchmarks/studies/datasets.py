"""The field's data sets by their own protocols, beside the figures of the Feature4X supplement."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from f4x_core.errors import F4xError
from f4x_core.evaluation.perceptual_distance import lpips_missing

from ..study import Context, Findings, Row, Table
from .protocols import (
    DYCHECK,
    NERFIES,
    NVIDIA,
    Protocol,
    fit_config,
    fit_scene,
    measure_views,
    read_scene_clip,
    scenes_of,
    sizes_of,
)
from .supplement import OURS, THEIRS, VIEWS

METHOD = "this program"
TIMED = ("fit (s)",)
MATCHED = (
    "Cameras of the test views are moved to match before they are scored (scene frozen), as in MoSca's evaluation, but the"
    " best step counts in place of the last; `as placed` is before that."
)


def study_nvidia(context: Context) -> Findings:
    """Table B: seven scenes of twelve frames, measured from the first camera at every time."""
    rows, failed = _measure(context, NVIDIA, scenes_of(context, NVIDIA.name, "poses_bounds.npy"))
    theirs = _theirs(rows)
    note = (
        f"RoDynRF's protocol: uint8 PSNR as `cv2.PSNR`, SSIM as scikit-image's defaults, LPIPS on AlexNet; cameras are found, not"
        f" given. {MATCHED} Sizes of ours: arrays in memory, theirs: checkpoints, features in static and dynamic."
    )
    return _findings([*rows, *_mean_row(rows), *theirs], failed, note, _compare(rows, theirs), "Test views (table B)")


def study_nerfies(context: Context) -> Findings:
    """The left camera learnt, the right one measured."""
    rows, failed = _measure(context, NERFIES, scenes_of(context, NERFIES.name, "camera/*.json"))
    return _findings(rows, failed, f"Masked figures as DyCheck's, split `mono`. {MATCHED}", _mean_word(rows))


def study_dycheck(context: Context) -> Findings:
    """Masked figures over co-visible pixels, and keypoints carried from frame to frame."""
    rows, failed = _measure(context, DYCHECK, scenes_of(context, DYCHECK.name, "camera/*.json"))
    note = (
        "Gao et al. 2022: PSNR, SSIM and LPIPS over pixels that enough training frames saw (`covisible/`); PCK: keypoints carried"
        f" between all pairs of annotated training frames, right within 5 % of the longer side. {MATCHED} The supplement has"
        " no figures of this data set."
    )
    return _findings([*rows, *_mean_row(rows)], failed, note, _mean_word(rows))


def _measure(context: Context, protocol: Protocol, folders: Sequence[Path]) -> tuple[list[Row], list[str]]:
    """Fit, place, draw and score every scene; one that fails costs no other: (rows, sentences of those that failed)."""
    rows, failed = [], []
    for folder in folders:
        try:
            clip = read_scene_clip(context, folder, protocol)
            config = fit_config(context, protocol.profile)
            scene, cost = fit_scene(context, clip, config, protocol.known_cameras)
            named = {"scene": folder.name, "source": OURS, "method": f"{METHOD}, profile {config.name}"}
            rows.append(named | measure_views(context, clip, scene, protocol) | sizes_of(scene) | cost)
        except F4xError as error:
            failed.append(f"{folder.name}: {error}")
    return rows, failed


def _theirs(ours: Sequence[Row]) -> list[Row]:
    """Published rows of the scenes that were measured, under the names that the folders have, and their means."""
    names = {str(row["scene"]).casefold(): row["scene"] for row in ours}
    rows = [row | {"scene": names[row["scene"].casefold()]} for row in VIEWS if row["scene"].casefold() in names]
    return rows + [row for row in VIEWS if row["scene"] == "mean"]


def _mean_row(rows: Sequence[Row]) -> list[Row]:
    """Return the mean of our scenes where there are several."""
    if len(rows) < 2:
        return []
    numbers = [name for name, value in rows[0].items() if isinstance(value, float)]
    means = {name: statistics.fmean(row[name] for row in rows if row.get(name) is not None) for name in numbers}
    words = {name: value for name, value in rows[0].items() if isinstance(value, str)}
    return [words | {"scene": "mean of these"} | means]


def _mean_word(rows: Sequence[Row]) -> list[str]:
    """Return a sentence of the mean over all measured scenes."""
    mean = [row["mPSNR (dB)"] for row in rows]
    return [f"{len(mean)} scenes: mean mPSNR {statistics.fmean(mean):.2f} dB."] if mean else []


def _compare(ours: Sequence[Row], theirs: Sequence[Row]) -> list[str]:
    """Our mean PSNR against the published one over the same scenes."""
    last = {row["scene"]: row["PSNR (dB)"] for row in theirs if row["source"] == THEIRS}
    both = [row for row in ours if row["scene"] in last]
    if not both:
        return []
    mine, published = (
        statistics.fmean(v) for v in zip(*((r["PSNR (dB)"], last[r["scene"]]) for r in both), strict=True)
    )
    return [f"{len(both)} of the published scenes: mean PSNR {mine:.3f} dB here, {published:.3f} dB in the supplement."]


def _findings(rows: list[Row], failed: list[str], note: str, words: list[str], title: str = "Test views") -> Findings:
    return Findings([Table("views", rows, title, TIMED, note)], [], words, lpips_missing(), failed)
