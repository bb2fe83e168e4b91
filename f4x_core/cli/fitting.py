"""`f4x fit` and `f4x priors`."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..batch.run import INPUT
from ..clip import Clip, read_clip, usual_width
from ..clip.images import enlarge_color, even_size, resize_color
from ..clip.model import MIN_FRAMES
from ..clip.notes import Remark
from ..clip.read import parse_span
from ..clip.stream import Survey, reported_frame_count, survey
from ..errors import F4xError
from ..evaluation.evaluate import evaluate, keep_measured
from ..features.models.providers import require_provider
from ..features.teachers import require_ready
from ..files import replace_file, sole_writer, user_path
from ..fit.budget import ClipSize, Grant, MachineSpeed, asked_gaussians, cost, for_clip, max_gaussians, within
from ..fit.checkpoint import OtherSettingsError
from ..fit.config import SETTINGS, THREADS, FitConfig, profile
from ..fit.distil_config import DistilConfig
from ..fit.linear_config import LinearConfig
from ..fit.pipeline import CHECKPOINT, NOT_DECIDING, fit_clip
from ..fit.settings import as_lines, list_settings, set_fields
from ..priors import build_priors
from ..priors.providers import STAGES
from ..progress import Progress
from ..reading import load_json, undamaged
from ..report.advice import about_cuts, quality, verdict
from ..scene import Scene
from ..windows.closing import closing_lines, needs_in_words
from ..windows.plan import LENGTHS, Shot, plan_shots, plan_windows, usual_length, usual_overlap
from ..windows.resuming import AT_ONCE, WINDOW, forget, remember, require_same, require_same_at_once, window_of
from ..windows.shots import fit_long
from ..windows.window import fit_here
from .checks import listed_teachers, require_backend
from .distilling import distill_into
from .refitting import refit_file

GRANT = "grant.json"
"""File beside the scene: the settings that `--minutes` and `--memory` came to."""
WIDTHS = (480, 854, 1280, 1920)
"""Widths of images whose cost is printed."""


def clip_of(args: argparse.Namespace, progress: Progress) -> Clip:
    """The clip that the arguments name."""
    return read_clip(args.clip, args.frames, width_of(args), args.hold_out, args.masks, progress)


def width_of(args: argparse.Namespace) -> int:
    """The picture width that the arguments ask for."""
    return usual_width(args.clip) if args.width is None else args.width


def config_of(args: argparse.Namespace) -> FitConfig:
    """The profile with the arguments' changes; `--set` has the last word."""
    config = profile(args.profile)
    for name in ("seed", "threads"):
        value = getattr(args, name)
        if value is not None and value < 0:
            raise F4xError(f"--{name} {value}: give a number that is not negative.")
    files = {}
    for entry in args.prior:
        name, separator, path = entry.partition("=")
        if not (separator and path):
            raise F4xError(f"--prior {entry}: write NAME=PATH, for example depth=my_depth_folder.")
        files[name] = str(user_path(path))
    priors = config.priors.with_provider(args.provider)
    for stage, name in (("cameras", args.cameras), ("depth", args.depth)):
        if name:
            require_provider(stage, name)  # before the fit, not in the middle of it
            priors = dataclasses.replace(priors, **{stage: dataclasses.replace(getattr(priors, stage), provider=name)})
    priors = dataclasses.replace(priors, files=files) if files else priors
    config = dataclasses.replace(config, seed=args.seed, threads=args.threads, backend=args.backend, priors=priors)
    config = set_fields(config, args.set)
    require_backend(config.backend)
    for stage in STAGES:
        name = getattr(config.priors, stage).provider
        if name != getattr(priors, stage).provider:
            require_provider(stage, name)
    return config


def run_priors(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Compute the priors folder only."""
    config = config_of(args)
    with sole_writer(args.output):
        return _priors(args, config, progress)


def _priors(args: argparse.Namespace, config: FitConfig, progress: Progress) -> dict[str, Any]:
    """Read the clip and write its priors."""
    clip = clip_of(args, progress)
    clip.require_enough()
    folder = args.output / "priors"
    priors = build_priors(clip, folder, config.priors_in_threads, progress)
    moving = float(priors.mask.mean()) if priors.mask is not None else 0.0
    lines = [f"{folder}: {len(priors.frames)} frames, camera {priors.camera_kind}, {moving:.1%} of the pixels move"]
    return {
        "folder": str(folder),
        **_leave_input(clip, len(clip), args.output),
        "camera_kind": priors.camera_kind,
        "min_moving_fraction": moving,
        "warnings": priors.warnings,
        "text": "\n".join([*lines, *remark_lines(clip.remarks), *(f"! {warning}" for warning in priors.warnings)]),
    }


def _leave_input(clip: Clip, frames: int, folder: Path) -> dict[str, int]:
    """Write the middle one of the clip's pictures, for pages that show what was fitted; the size of all its `frames`."""
    with replace_file(folder / INPUT) as file:
        Image.fromarray(clip.frames[len(clip) // 2]).save(file, "JPEG")
    return {"frames": frames, "width": clip.width, "height": clip.height}


DETAIL = (
    (np.inf, "all of the clip's detail"),
    (35, "hardly a difference from the clip"),
    (25, "fine detail such as hair, leaves and small letters is missing"),
    (-np.inf, "soft all over"),
)
"""Least dB from the clip's own pictures -> what a person sees of one, by the README's scale."""


def run_window(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fit one window of a long clip, for the process that joins them."""
    fit_here(args.request, progress)
    return {}


def run_fit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fit a clip and write the scene, its metrics and the diagnostics page."""
    config = config_of(args)
    if args.show_config:
        return show_config(config)
    names = [] if args.features is None else listed_teachers(args.features, "--features")
    for name in names:
        if not (args.output / "features" / name / "spec.json").is_file():
            require_ready(name)  # before the fit, not after it
    with sole_writer(args.output):
        return _fit(args, config, names, progress)


def _fit(args: argparse.Namespace, config: FitConfig, names: list[str], progress: Progress) -> dict[str, Any]:
    """Read the clip, fit it at once or in windows, and distil the features `names`."""
    cut = Cut.of(args, config)
    made_with = options_of(args, config, cut)
    if args.resume:
        require_same(args.output, made_with)
    windows = windows_of(args, cut, progress)
    if windows is not None:
        remember(args.output, made_with)
        known, shots = windows
        parts = [window for shot in shots for window in shot.windows]
        first = _first_picture(args, width_of(args))
        size = ClipSize(max(end - start for start, end in parts), first.width, first.height, len(parts))
        config = granted(args, size, config, progress)
        return fit_windows(args, known, shots, config, names, progress)
    clip = clip_of(args, progress)
    clip.require_enough()
    if not args.resume:
        forget(args.output)
    size = ClipSize(len(clip.supervised), clip.width, clip.height)
    config = granted(args, size, config, progress)
    try:
        result = fit_to_folder(clip, args.output, config, progress, args.resume)
    except OtherSettingsError:
        require_same_at_once(args.output, made_with)
        raise
    finally:
        if not args.resume and (args.output / CHECKPOINT).is_file():
            remember(args.output, made_with)
    if names:
        settings = DistilConfig(seed=config.seed, threads=config.threads, backend=config.backend)
        path = Path(result["scene"])
        added = distill_into(path, args.clip, names, args.output / "features", settings, progress)
        result |= {"features": added, "text": result["text"] + "\n" + added.pop("text")}
    if args.linear_light:
        refitted = refit_file(Path(result["scene"]), linear_config(config), args.resume, progress)
        result |= {"linear_light": refitted, "text": result["text"] + "\n" + refitted.pop("text")}
    return result


def linear_config(config: FitConfig) -> LinearConfig:
    """The refit for linear light that belongs to a fit."""
    return LinearConfig(seed=config.seed, threads=config.threads or 0)


def granted(args: argparse.Namespace, size: ClipSize, config: FitConfig, progress: Progress) -> FitConfig:
    """The configuration within what `--minutes` and `--memory` allow; prints what the fit of a clip of `size` costs.

    An interrupted fit goes on with the steps and Gaussians it was granted.
    """
    for name in ("minutes", "memory"):
        value = getattr(args, name)
        if value is not None and not (np.isfinite(value) and value > 0):
            raise F4xError(f"--{name} {value:g}: give a number above 0.")
    path, speed = args.output / GRANT, MachineSpeed.measured(config.kernels.threads)
    config = for_clip(args.minutes, size, config, speed)
    if args.resume and path.is_file():
        with undamaged(path, "delete it and fit again without --resume"):
            allowed = set_fields(config, load_json(path))
    else:
        allowed = within(Grant(args.minutes, args.memory), size, config, speed)
        if allowed is not config:
            _keep_grant(path, allowed)
    binds = allowed.counts_from != SETTINGS and max_gaussians(allowed) < asked_gaussians(size, allowed)
    room = f"; room for {max_gaussians(allowed):,} Gaussians by {allowed.counts_from}" if binds else ""
    room += "; --features takes minutes more" if args.features else ""
    progress("cost", 1, 1, f"{cost(size, allowed, speed)}{room}")
    larger = _larger(args, size, allowed, speed)
    if larger:
        progress("larger pictures", 1, 1, larger)
    return allowed


def _keep_grant(path: Path, config: FitConfig) -> None:
    """Write how many steps and Gaussians were granted, as `set_fields` reads it."""
    counts = [
        setting
        for setting in list_settings(config)
        if setting.name == "steps" or setting.name.endswith(("max_count", "counts_from", "own_counts"))
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as file:
        file.write(json.dumps([f"{setting.name}={setting.text}" for setting in counts]).encode())


def _first_picture(args: argparse.Namespace, width: int | None = None) -> Clip:
    """The first of the clip's pictures that are used, `width` pixels wide or as they are."""
    start = parse_span(args.frames).start or 0
    return read_clip(args.clip, f"{start}:{start + 1}", width)


def _larger(args: argparse.Namespace, size: ClipSize, config: FitConfig, speed: MachineSpeed) -> str:
    """What larger pictures of the same clip would cost and show; empty where there are none."""
    first = _first_picture(args).frames[0]
    height, width = first.shape[:2]
    widths = [size.width, *(wanted for wanted in WIDTHS if size.width < wanted <= width)]
    words = []
    for wanted in widths if len(widths) > 1 else ():
        small_width, small_height = even_size(width, height, wanted)
        small = resize_color(first, small_width, small_height)
        missed = np.mean((enlarge_color(small, width, height).astype(np.float64) - first) ** 2)
        shown = detail_in_words(10 * np.log10(255**2 / missed) if missed else np.inf)
        minutes = cost(dataclasses.replace(size, width=small_width, height=small_height), config, speed).minutes
        which = f"{wanted}, as now" if wanted == size.width else f"--width {wanted}"
        words.append(f"{which}: {shown}, {minutes:.1f} minutes")
    return f"the clip is {width} pixels wide; {'; '.join(words)}" if words else ""


def detail_in_words(psnr: float) -> str:
    """What is seen of a picture that is `psnr` dB from the clip's own."""
    seen = next(words for least, words in DETAIL if psnr >= least)
    return seen if np.isinf(psnr) else f"{seen} ({psnr:.0f} dB)"


def show_config(config: FitConfig) -> dict[str, Any]:
    """Every setting with its value, what it may be and what it does."""
    rows = {
        setting.name: {
            "value": setting.value if setting.settable else dict(setting.value),
            "kind": setting.kind,
            "help": setting.doc,
        }
        for setting in list_settings(config)
    }
    return {"config": rows, "text": as_lines(config)}


@dataclasses.dataclass(frozen=True)
class Cut:
    """How a clip is cut into windows."""

    length: int
    """Frames of a window; 0 for a clip that is fitted at once."""
    overlap: int
    """Frames that neighbouring windows share."""

    @classmethod
    def of(cls, args: argparse.Namespace, config: FitConfig) -> Cut:
        """What the arguments ask for, what the fit that is continued was cut into, or what is usual for such a clip."""
        length = args.window
        if length is None and args.resume:
            length = window_of(args.output)
        if length is None:
            frames, length = reported_frame_count(args.clip, args.frames), 0
            if frames > LENGTHS[-1]:
                first = _first_picture(args, width_of(args))
                length = usual_length(ClipSize(frames, first.width, first.height), config, args.memory)
        return cls(length, usual_overlap(length) if args.overlap is None else args.overlap)


def options_of(args: argparse.Namespace, config: FitConfig, cut: Cut) -> dict[str, str]:
    """The options that decide what a fit becomes, or the windows of a long clip, by name, as text."""
    span = parse_span(args.frames)
    settings = [s for s in list_settings(config) if s.settable and s.name.rpartition(".")[2] != THREADS]
    if cut.length:
        of_its_kind = {WINDOW: str(cut.length), "--overlap": str(cut.overlap)}
    else:
        of_its_kind = {WINDOW: AT_ONCE, "CLIP": str(args.clip), "--masks": str(args.masks or "none")}
        of_its_kind["--prior"] = " ".join(args.prior) or "none"
        settings = [setting for setting in settings if setting.name not in NOT_DECIDING]
    return {
        **of_its_kind,
        "--frames": f"{span.start or 0}:{'' if span.stop is None else span.stop}:{span.step or 1}",
        "--width": str(width_of(args)),
        "--hold-out": str(args.hold_out or 0),
        "--profile": args.profile,
        **{f"--set {setting.name}": setting.text for setting in settings},
    }


def windows_of(args: argparse.Namespace, cut: Cut, progress: Progress) -> tuple[Survey, tuple[Shot, ...]] | None:
    """Return the survey and the shots of a clip that is fitted in windows; None for one that is fitted at once."""
    if cut.length == 0:
        return None
    plan_windows(0, cut.length, cut.length, cut.overlap)  # a wrong pair is refused before the clip is read
    if args.prior:
        raise F4xError("--prior cannot be cut into windows; fit with --window 0, or leave it out.")
    known = survey(args.clip, args.frames, width_of(args), progress)
    shots = plan_shots(known.count, known.cuts, cut.length, cut.overlap)
    if not shots:
        raise F4xError(f"{args.clip}: no shot of this clip has {MIN_FRAMES} frames; give --window 0 to fit it as one.")
    return known, shots


def fit_windows(
    args: argparse.Namespace,
    known: Survey,
    shots: tuple[Shot, ...],
    config: FitConfig,
    names: list[str],
    progress: Progress,
) -> dict[str, Any]:
    """Fit a long clip window by window and distil the features `names` into each shot's scene."""

    width = width_of(args)
    clocks = {shot: known.clock(shot.start, shot.end) for shot in shots}

    def read(start: int, end: int) -> Clip:
        shot = next(shot for shot in shots if shot.start <= start < shot.end)
        times, fps = clocks[shot].times[start - shot.start : end - shot.start], clocks[shot].fps
        clip = read_clip(args.clip, known.part(start, end), width, None, args.masks, progress)
        step = args.hold_out
        held_out = np.arange(start, end) % step == step - 1 if step else clip.held_out
        return dataclasses.replace(clip, held_out=held_out, times=times - times[0], fps=fps, remarks=known.remarks)

    fitted_shots = fit_long(shots, read, args.output, config, progress, args.resume)
    lines = remark_lines(known.remarks)
    for shot in fitted_shots:
        figures = shot["metrics"]
        lines.append(
            f"{shot['scene']}: frames {shot['picked']} in {shot['windows']} windows, {shot['static']:,} static and"
            f" {shot['dynamic']:,} dynamic Gaussians, PSNR of used frames {figures['used_psnr']:.2f} dB"
        )
        if "seam_psnr" in figures:
            lines[-1] += f" ({figures['seam_psnr']:.2f} dB where windows meet, {figures['rest_psnr']:.2f} dB elsewhere)"
        lines += closing_lines(Path(shot["scene"]).parent, shot["needs"], figures)
        if names:
            settings = DistilConfig(seed=config.seed, threads=config.threads, backend=config.backend)
            path = Path(shot["scene"])
            added = distill_into(path, args.clip, names, path.parent / "features", settings, progress)
            lines.append(added.pop("text"))
            shot["features"] = added
        if args.linear_light:
            shot["linear_light"] = refit_file(Path(shot["scene"]), linear_config(config), args.resume, progress)
            lines.append(shot["linear_light"].pop("text"))
    longest = max(fitted_shots, key=lambda shot: shot["frames"][1] - shot["frames"][0])
    start, end = longest["frames"]
    middle = start + (end - start) // 2
    result = {
        "scene": str(args.output / "scene.f4x"),
        **_leave_input(read(middle, middle + 1), end - start, args.output),
        "metrics": longest["metrics"],
        "quality": longest["metrics"]["quality"],
        "needs": longest["needs"],
        "shots": fitted_shots,
        "cuts": list(known.cuts),
    }
    if len(fitted_shots) > 1:  # where those look who know no shots
        for name in ("scene.f4x", "metrics.json"):
            with replace_file(args.output / name) as file:
                file.write(Path(longest["scene"]).with_name(name).read_bytes())
        result["note"] = f"{len(fitted_shots)} shots; {result['scene']} is the longest, --frames {longest['picked']}"
        lines.append(f"! {result['note']}")
    return {**result, "text": "\n".join(lines)}


def fit_to_folder(clip: Clip, folder: Path, config: FitConfig, progress: Progress, resume: bool) -> dict[str, Any]:
    """Fit, measure, and leave `scene.f4x`, `metrics.json`, `diagnostics.html` and checkpoints in `folder`."""
    result = fit_clip(clip, folder, config, progress, resume)
    from ..report.diagnostics import (  # matplotlib: a second that the start need not wait
        render_previews,
        write_diagnostics,
    )

    scene = result.scene
    masks = result.priors.moving_masks
    metrics = evaluate(scene, clip, baselines=True, masks=masks, backend=config.backend, progress=progress)
    scene, figures = keep_measured(folder, scene, metrics, seconds=result.seconds)
    path = folder / "scene.f4x"
    images = render_previews(scene, metrics, config.backend)
    report = folder / "diagnostics.html"
    found = write_diagnostics(report, clip, result, metrics, images)
    summary: dict[str, Any] = {"scene": str(path), "metrics": figures, "needs": list(scene.needs)}
    summary["quality"] = quality(metrics, found)
    lines = [_summary(path, scene, figures), *remark_lines(clip.remarks)]
    lines += [f"{verdict(metrics, found)} Why, and what you can supply: {report}"]
    for cut in about_cuts(result.priors, clip.picked):
        summary["note"] = f"{cut.what} {cut.advice}"
        lines.append(f"! {summary['note']}")
    return {**summary, "text": "\n".join(lines)}


def remark_lines(remarks: Iterable[Remark]) -> list[str]:
    """Lines for the terminal of what was left out, mended or guessed while a clip was read."""
    return [f"! {remark}" for remark in remarks]


def _summary(path: Path, scene: Scene, figures: dict[str, Any]) -> str:
    cameras = scene.cameras
    lines = [
        f"{path}: {len(scene.static):,} static and {len(scene.dynamic):,} dynamic Gaussians"
        f" from {len(cameras)} frames of {cameras.width}x{cameras.height} pixels"
    ]
    lines += [f"PSNR of used frames {figures['used_psnr']:.2f} dB"]
    if "held_out_psnr_registered" in figures:
        lines[-1] += f", held-out frames {figures['held_out_psnr_registered']:.2f} dB"
        also = {
            "held_out_psnr_flow_blend_registered": "a blend of their neighbours",
            "held_out_psnr": "with interpolated cameras",
        }
        shown = [f"{title} {figures[name]:.2f} dB" for name, title in also.items() if name in figures]
        lines[-1] += f" ({', '.join(shown)})"
    lines.append(f"what the clip needed: {needs_in_words(scene.needs)}")
    return "\n".join(lines)
