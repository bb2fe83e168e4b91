"""The diagnostics page: one HTML file, pictures inside, that says in words and shows how a scene came about."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from .. import page
from ..clip import Clip
from ..clip.images import resize_color
from ..files import replace_file
from ..fit.pipeline import FitResult
from ..geometry.arrays import evenly_spaced
from ..metrics.viewing_angles import parallax_degrees
from ..priors import STAGES, Priors
from ..scaffold import Scaffold
from ..scene import Scene
from ..scene.moments import Moment, draw_moments
from ..scene.view import render
from .advice import SHORT_PROFILE, about_reading, about_room, fair_psnr, findings, track_survival, verdict
from .finding import Finding, by_cause
from .geometry_findings import ClipGeometry
from .geometry_section import geometry_section

# Frames shown for masks, depth and scaffold, and frames shown because they are the worst.
SHOWN_FRAMES, WORST_FRAMES = 6, 4
# Moments shown with depth and views aside; the first and the last frame are not among them.
MOMENTS = 3
# Absolute error (mean over channels, colours in [0,1]) that is painted brightest.
ERROR_SPAN = 0.25
# Depth colours span these quantiles of the clip's depth.
DEPTH_QUANTILES = (0.02, 0.98)


@dataclass(frozen=True)
class ScoreRow:
    """A row of the score table; columns are names of `evaluation.evaluate.summary` without `used_` and `held_out_`."""

    title: str
    held_out: str
    used: str = ""
    """Empty where used frames have no such score."""


SCORES = (
    ScoreRow("whole picture", "psnr_registered", "psnr"),
    ScoreRow("what moves", "psnr_moving_registered", "psnr_moving"),
    ScoreRow("what stands still", "psnr_static_registered", "psnr_static"),
    ScoreRow("what moves, by the mask", "psnr_mask", "psnr_mask"),
    ScoreRow("blend of the neighbours instead", "psnr_flow_blend_registered"),
    ScoreRow("whole picture, camera interpolated", "psnr"),
    ScoreRow("whole picture, camera refined on its colours", "psnr_refined"),
    ScoreRow("blend of the neighbours, camera interpolated", "psnr_flow_blend"),
    ScoreRow("nearest used frame instead", "psnr_nearest"),
)


def worst_frames(metrics: Mapping[str, Any], count: int = WORST_FRAMES) -> list[int]:
    """Clip frames with the lowest PSNR, worst first; what `write_diagnostics` wants pictures of."""
    rows = sorted(metrics.get("frames", []), key=fair_psnr)
    return [row["frame"] for row in rows[:count]]


@dataclass(frozen=True)
class ScenePreviews:
    """Renders of the fitted scene that the page shows."""

    worst: Mapping[int, np.ndarray]
    """Clip frame -> the scene's picture of it, (H,W,3) uint8 or float in [0,1]."""
    moments: Sequence[Moment] = ()
    """A few moments with depth and views aside."""


def render_previews(scene: Scene, metrics: Mapping[str, Any], backend: str = "auto") -> ScenePreviews:
    """Draw the scene's worst frames by `metrics`, and moments spread over the frames that were not held out."""
    times = scene.cameras.times
    worst = {
        frame: render(scene, scene.cameras[frame], float(times[frame]), ("rgb",), backend)["rgb"]
        for frame in worst_frames(metrics)
    }
    used = np.setdiff1d(np.arange(len(times)), scene.held_out)
    chosen = used[evenly_spaced(len(used), MOMENTS, ends=False)]
    return ScenePreviews(worst, draw_moments(scene, chosen, backend=backend))


def write_diagnostics(
    path: Path | str, clip: Clip, result: FitResult, metrics: Mapping[str, Any], images: ScenePreviews
) -> list[Finding]:
    """Write the page atomically; returns what it says about why the scene is as it is.

    Args:
        path: the HTML file.
        clip: the clip that was fitted.
        result: what the fit left.
        metrics: the result of `evaluation.evaluate.evaluate`: its means, and rows of single frames under `frames`.
        images: the scene's worst frames and its views aside.

    Raises:
        F4xError: the file cannot be written.
    """
    priors, scaffold = result.priors, result.scene.scaffold
    profile = str(result.scene.provenance.get("config", {}).get("name", SHORT_PROFILE))
    found = [*about_reading(clip.remarks), *about_room(result.shortages)]
    found = by_cause([*found, *findings(priors, scaffold, metrics, clip.picked, profile)])
    shown = evenly_spaced(len(priors.frames), SHOWN_FRAMES)
    sections = [
        ("Why the scene is as it is, and what you can supply", finding_boxes(found)),
        ("Geometry", geometry_section(result, ClipGeometry.of(priors, scaffold), images.moments)),
        ("Scores", _scores(metrics) + page.plots([frame_scores(metrics), _quality_curve(result.history)])),
        ("What the clip needed", needs_table(result.scene.needs)),
        ("Worst frames: input, render, error", _worst(clip, metrics, images.worst)),
        ("What moves: score and mask", _motion(clip, priors, shown)),
        ("Tracks", page.plots([_survival(priors)])),
        ("Camera", _camera_words(result) + page.plots([_field_of_view(priors)])),
        ("Depth and its confidence", _depth(priors, shown)),
        ("Motion scaffold: nodes, measured (bright) or filled in (dark)", _scaffold(clip, priors, scaffold, shown)),
        ("Time", page.plots([_times(result.seconds, priors)])),
        ("Provenance", _provenance(result.scene.provenance)),
    ]
    body = [
        f'<p class="verdict">{html.escape(verdict(metrics, found))}</p>',
        f'<p class="dim">{html.escape(_counts(clip, result))}</p>',
        *(page.section(title, content) for title, content in sections),
    ]
    with replace_file(path) as file:
        file.write(page.document(clip.name, body))
    return found


# ---------------------------------------------------------------------------------------------------- words and tables


def _counts(clip: Clip, result: FitResult) -> str:
    static, dynamic = len(result.scene.static), len(result.scene.dynamic)
    nodes = len(result.scene.scaffold) if result.scene.scaffold is not None else 0
    held_out = int(clip.held_out.sum())
    return (
        f"{len(clip)} frames of {clip.width}×{clip.height}, {held_out} held out · {static:,} static and {dynamic:,} moving"
        f" Gaussians · {nodes} motion nodes · {clip.source}"
    )


def finding_boxes(found: Sequence[Finding]) -> str:
    """Return the findings as boxes (HTML) whose colour tells their weight; what is no problem stands apart, below."""
    problems = [finding for finding in found if finding.weight == "problem"]
    rest = [finding for finding in found if finding.weight != "problem"]
    apart = f"<h3>{'Also worth knowing' if problems else 'Worth knowing'}</h3>" if rest else ""
    return "".join([*map(_box, problems), apart, *map(_box, rest)])


def _box(finding: Finding) -> str:
    advice = f'<div class="advice">{html.escape(finding.advice)}</div>' if finding.advice else ""
    return f'<div class="finding {finding.weight}">{html.escape(finding.what)}{advice}</div>'


def needs_table(needs: Iterable[Mapping[str, str]]) -> str:
    """Return a table (HTML) of a scene's needs, their evidence, and what they saved."""
    columns = ("what", "chosen", "evidence", "saved")
    return page.table(["", *columns[1:]], [[row[name] for name in columns] for row in needs])


def _scores(metrics: Mapping[str, Any]) -> str:
    def cell(name: str) -> str:
        return f"{metrics[name]:.2f}" if name in metrics else "–"

    rows = [
        [row.title, cell(f"used_{row.used}"), cell(f"held_out_{row.held_out}")]
        for row in SCORES
        if f"used_{row.used}" in metrics or f"held_out_{row.held_out}" in metrics
    ]
    return page.table(["PSNR in dB", "used frames", "held-out frames"], rows, numbers=True) if rows else ""


def _camera_words(result: FitResult) -> str:
    cameras, priors = result.scene.cameras, result.priors
    across = np.degrees(2 * np.arctan(cameras.width / (2 * cameras.intrinsics[:, 0, 0])))
    view = f"{across.min():.1f}°" if np.ptp(across) < 0.1 else f"{across.min():.1f}° to {across.max():.1f}°"
    kind = {"moving": "moves", "pan": "only turns", "static": "stands still"}.get(str(priors.camera_kind), "is unknown")
    length = float(np.linalg.norm(np.diff(cameras.centers, axis=0), axis=1).sum())
    known = priors.statistics.get("cameras", {})
    error = known.get("reprojection_px", {}).get("median")
    extra = f"; {known['registered']} frames found their camera by themselves" if "registered" in known else ""
    extra += f"; tracks are met within {error:.2f} px (median)" if error is not None else ""
    return (
        f"<p>The camera {kind}: its path is {length:.2f} median depths long and spans {parallax_degrees(priors):.1f}° of"
        f" parallax; it looks across {view}{html.escape(extra)}.</p>"
    )


def _provenance(provenance: Mapping[str, Any]) -> str:
    rows = [[key, str(value)] for key, value in provenance.items() if not isinstance(value, Mapping)]
    made = provenance.get("priors", {})
    providers = [
        [f"prior: {stage}", ", ".join(sorted({made[name].get("provider", "?") for name in names if name in made}))]
        for stage, names in STAGES.items()
    ]
    everything = html.escape(json.dumps(provenance, indent=1, default=str))
    return (
        page.table(["", ""], rows + providers)
        + f"<details><summary>every setting</summary><pre>{everything}</pre></details>"
    )


# ------------------------------------------------------------------------------------------------------------ pictures


def _coloured(values: np.ndarray, colours: str) -> np.ndarray:
    """Return (H,W) values in [0,1] as (H,W,3) colours; NaN is grey."""
    painted = matplotlib.colormaps[colours](np.nan_to_num(np.clip(values, 0, 1)))[..., :3]
    painted[~np.isfinite(values)] = 0.5
    return painted


def _worst(clip: Clip, metrics: Mapping[str, Any], images: Mapping[int, np.ndarray]) -> str:
    rows = {row["frame"]: row for row in metrics.get("frames", [])}
    order = sorted((frame for frame in images if frame in rows), key=lambda frame: rows[frame]["psnr"])
    lines = []
    for frame in order[:WORST_FRAMES]:
        truth, drawn = clip.frames[frame], page.as_bytes(images[frame])
        error = np.abs(truth.astype(np.float32) - drawn).mean(-1) / 255
        kind = "held out" if rows[frame]["held_out"] else "used"
        lines.append(
            page.row(
                [
                    page.image_figure(truth, f"frame {frame} ({kind})"),
                    page.image_figure(drawn, f"{rows[frame]['psnr']:.1f} dB"),
                    page.image_figure(_coloured(error / ERROR_SPAN, "magma"), f"error, white = {ERROR_SPAN:.2f}"),
                ]
            )
        )
    return "".join(lines)


def _motion(clip: Clip, priors: Priors, shown: Iterable[int]) -> str:
    """Return the soft score in red over the grey frame, the mask's edge in white."""
    if priors.motion is None or priors.mask is None:
        return ""
    figures = []
    for frame in shown:
        index, mask = int(priors.frames[frame]), priors.mask[frame]
        picture = resize_color(clip.frames[index], priors.width, priors.height)
        grey = picture.mean(-1, keepdims=True).repeat(3, -1) / 255
        score = priors.motion[frame].astype(np.float64)[..., None]
        painted = grey * (1 - 0.6 * score) + 0.6 * score * np.array([0.95, 0.3, 0.15])
        painted[_edge(mask)] = 1
        figures.append(page.image_figure(painted, f"frame {index}: {mask.mean():.1%} moves"))
    return page.row(figures)


def _edge(mask: np.ndarray) -> np.ndarray:
    """Return the pixels of a mask (H,W) with a 4-neighbour outside it."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner


def _depth(priors: Priors, shown: Sequence[int] | np.ndarray) -> str:
    """Return the inverse depth and confidence in turbo colours."""
    if priors.depth is None:
        return ""
    inverse = 1 / priors.depth[shown].astype(np.float64)
    far, near = np.nanquantile(inverse, DEPTH_QUANTILES)
    figures = []
    for frame, values in zip(shown, inverse, strict=True):
        index = int(priors.frames[frame])
        unknown = float(np.mean(~np.isfinite(values)))
        caption = f"frame {index}: near is red" + (f", {unknown:.0%} unknown (grey)" if unknown else "")
        figures.append(page.image_figure(_coloured((values - far) / max(near - far, 1e-9), "turbo"), caption))
    if priors.depth_confidence is not None:
        for frame in shown:
            values = priors.depth_confidence[frame].astype(np.float64)
            caption = f"frame {int(priors.frames[frame])}: confidence, median {np.median(values):.2f}"
            figures.append(page.image_figure(_coloured(values, "viridis"), caption))
    return page.row(figures)


def _scaffold(clip: Clip, priors: Priors, scaffold: Scaffold | None, shown: Iterable[int]) -> str:
    """Return the nodes projected on the frames."""
    if scaffold is None or priors.cameras is None:
        return ""
    from PIL import ImageDraw

    figures = []
    for frame in shown:
        index = int(priors.frames[frame])
        scale = page.PICTURE_WIDTH / priors.width
        faded = Image.fromarray(page.as_bytes(0.35 + 0.5 * clip.frames[index] / 255))
        faded = faded.resize((page.PICTURE_WIDTH, max(1, round(priors.height * scale))))
        draw = ImageDraw.Draw(faded)
        pixels, depth = priors.cameras[frame].project(scaffold.xyz[frame].astype(np.float64))
        for (x, y), sure in zip(scale * pixels[depth > 0], scaffold.certain[frame, depth > 0], strict=True):
            draw.ellipse([x - 3, y - 3, x + 3, y + 3], fill="#ff7a2f" if sure else "#4b2a63", outline="white")
        certain = float(scaffold.certain[frame].mean()) if len(scaffold) else 0.0
        figures.append(
            page.image_figure(np.asarray(faded), f"frame {index}: {certain:.0%} of {len(scaffold)} nodes measured")
        )
    return page.row(figures)


# --------------------------------------------------------------------------------------------------------------- plots


def frame_scores(metrics: Mapping[str, Any], shared: Iterable[tuple[int, int]] = ()) -> str:
    """Plot (SVG) the PSNR of every frame, held-out ones with their registered cameras.

    `shared` (first frame, end) are frames of two windows, which are shaded.
    """
    rows = metrics.get("frames", [])
    if not rows:
        return ""
    figure, (axis,) = page.plot("PSNR of every frame", "clip frame", "dB")
    for number, (start, end) in enumerate(shared):
        label = None if number else "shared by two windows"
        axis.axvspan(start, end - 1, color=page.VIOLET, alpha=0.25, linewidth=0, label=label)
    axis.plot([row["frame"] for row in rows], [fair_psnr(row) for row in rows], color=page.GREY, linewidth=0.8)
    for held_out, colour, label in ((False, page.TEAL, "used"), (True, page.ORANGE, "held out")):
        chosen = [row for row in rows if row["held_out"] == held_out]
        if chosen:
            places = [row["frame"] for row in chosen], [fair_psnr(row) for row in chosen]
            axis.scatter(*places, s=14, color=colour, label=label, zorder=3)
    page.legend(axis)
    return page.svg(figure)


def _quality_curve(history: Sequence[Mapping[str, float]]) -> str:
    if not history:
        return ""
    figure, axes = page.plot("", "step", "", columns=2)
    steps = [point["step"] for point in history]
    for axis, name, title, colour in zip(
        axes, ("loss", "psnr"), ("loss", "PSNR in dB"), (page.VIOLET, page.TEAL), strict=True
    ):
        axis.plot(steps, [point[name] for point in history], color=colour, marker="o", markersize=3)
        axis.set_title(title, fontsize=10, color=page.TEXT_COLOUR)
        axis.locator_params(axis="x", nbins=4)
    return page.svg(figure)


def _survival(priors: Priors) -> str:
    if priors.tracks_visible is None:
        return ""
    figure, (axis,) = page.plot("fraction of tracks still followed", "frames since first seen", "fraction")
    axis.plot(track_survival(priors.tracks_visible), color=page.TEAL, label=f"all {priors.tracks_visible.shape[1]:,}")
    if priors.tracks_motion is not None and (moving := priors.tracks_motion > 0.5).any():
        survival = track_survival(priors.tracks_visible[:, moving])
        axis.plot(survival, color=page.ORANGE, label=f"{int(moving.sum()):,} that move")
    axis.set_ylim(0, 1.02)
    page.legend(axis)
    return page.svg(figure)


def _field_of_view(priors: Priors) -> str:
    """Return the reprojection error of the camera solution over trial fields of view, where the provider searched them."""
    known = priors.statistics.get("cameras", {})
    curve = known.get("focal_search") or known.get("pan_focal_search")
    if not curve:
        return ""
    figure, (axis,) = page.plot("camera error by field of view", "degrees across", "pixels")
    degrees = np.degrees(2 * np.arctan(0.5 / np.array(curve["focal_over_width"])))
    axis.plot(degrees, curve["error_px"], color=page.VIOLET, marker="o", markersize=3)
    if "fov_degrees" in known:
        axis.axvline(known["fov_degrees"], color=page.ORANGE, linestyle="--", linewidth=1, label="chosen")
        page.legend(axis)
    return page.svg(figure)


def _times(seconds: Mapping[str, float], priors: Priors) -> str:
    """Return the bars of the stages of the priors (as their folder remembers them) and of the fit."""
    bars = {}
    for stage, fields in STAGES.items():
        entry = next((priors.provenance[name] for name in fields if name in priors.provenance), {})
        if "seconds" in entry:
            bars[f"priors: {stage}"] = entry["seconds"]
    # The fit's own lap of the priors is the sum of theirs, or nothing when they were there already.
    bars |= {name: value for name, value in seconds.items() if name != "priors"}
    if not bars:
        return ""
    figure, (axis,) = page.plot("seconds per stage", "seconds", "", height=0.7 + 0.28 * len(bars))
    names = list(bars)[::-1]
    drawn = axis.barh(names, [bars[name] for name in names], color=page.TEAL)
    axis.bar_label(drawn, fmt="%.1f", fontsize=8, color=page.TEXT_COLOUR, padding=3)
    return page.svg(figure)
