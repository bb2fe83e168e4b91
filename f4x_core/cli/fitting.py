"""`f4x fit` and `f4x priors`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from ..app.fit_options import ClipOptions, FitOptions, FitRequest
from ..app.fitting import Fitted, make_priors, make_scene
from ..clip.notes import Remark
from ..errors import F4xError
from ..files import user_path
from ..fit.config import FitConfig, profile
from ..fit.settings import as_lines, list_settings, set_fields
from ..progress import Progress
from ..report.fitted import FittedScene
from ..windows.closing import closing_lines, needs_in_words
from ..windows.window import fit_here
from .checks import listed_teachers
from .distilling import distilled_result
from .refitting import refitted_result


def clip_options_of(args: argparse.Namespace) -> ClipOptions:
    """Return the pictures that the arguments choose."""
    return ClipOptions(args.frames, args.width, args.hold_out, args.masks)


def config_of(args: argparse.Namespace) -> FitConfig:
    """Return the profile with the arguments' changes; `--set` has the last word."""
    config = profile(args.profile)
    files = {}
    for entry in args.prior:
        name, separator, path = entry.partition("=")
        if not (separator and path):
            raise F4xError(f"--prior {entry}: write NAME=PATH, for example depth=my_depth_folder.")
        files[name] = str(user_path(path))
    priors = config.priors.with_provider(args.provider)
    for stage, name in (("cameras", args.cameras), ("depth", args.depth)):
        if name:
            priors = replace(priors, **{stage: replace(getattr(priors, stage), provider=name)})
    priors = replace(priors, files=files) if files else priors
    config = replace(config, seed=args.seed, threads=args.threads, backend=args.backend, priors=priors)
    return set_fields(config, args.set)


def fit_options_of(args: argparse.Namespace) -> FitOptions:
    """Return everything that the arguments of a fit ask for."""
    names = () if args.features is None else tuple(listed_teachers(args.features, "--features"))
    limits = {"minutes": args.minutes, "memory": args.memory, "window": args.window, "overlap": args.overlap}
    more = {"resume": args.resume, "features": names, "linear_light": args.linear_light}
    return FitOptions(config_of(args), clip_options_of(args), **limits, **more)


def run_fit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fit a clip and write the scene, its metrics and the diagnostics page."""
    if args.show_config:
        return show_config(FitOptions(config_of(args)).config)
    fitted = make_scene(args.clip, args.output, fit_options_of(args), progress)
    return result_at_once(fitted) if fitted.cuts is None else result_in_windows(fitted)


def run_window(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Fit one window of a long clip, for the process that joins them."""
    fit_here(args.request, progress)
    return {}


def run_priors(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Compute the priors folder only."""
    options = FitOptions(config_of(args), clip_options_of(args))
    made = make_priors(FitRequest(args.clip, args.output, options), progress)
    priors = made.priors
    moving = float(priors.mask.mean()) if priors.mask is not None else 0.0
    found = f"{len(priors.frames)} frames, camera {priors.camera_kind}, {moving:.1%} of the pixels move"
    lines = [f"{made.folder}: {found}", *remark_lines(made.remarks), *(f"! {warning}" for warning in priors.warnings)]
    return {
        "folder": str(made.folder),
        "frames": made.frames,
        "width": made.size[0],
        "height": made.size[1],
        "camera_kind": priors.camera_kind,
        "moving_fraction": moving,
        "warnings": priors.warnings,
        "text": "\n".join(lines),
    }


def show_config(config: FitConfig) -> dict[str, Any]:
    """Return every setting with its value, what it may be and what it does."""
    rows = {
        setting.name: {
            "value": setting.value if setting.settable else dict(setting.value),
            "kind": setting.kind,
            "help": setting.doc,
        }
        for setting in list_settings(config)
    }
    return {"config": rows, "text": as_lines(config)}


def result_at_once(fitted: Fitted) -> dict[str, Any]:
    """Return the result of a fit at once."""
    scene = fitted.main
    lines = [*_summary(scene), *remark_lines(fitted.remarks)]
    lines.append(f"{fitted.verdict} Why, and what you can supply: {scene.page}")
    lines += [f"! {note}" for note in fitted.notes]
    added = added_to(fitted, 0)
    result = {"scene": str(scene.path), "metrics": scene.metrics, "needs": [*scene.needs], "quality": fitted.quality}
    result |= {"note": fitted.notes[-1]} if fitted.notes else {}
    return result | added | {"text": "\n".join([*lines, *(each.pop("text") for each in added.values())])}


def result_in_windows(fitted: Fitted) -> dict[str, Any]:
    """Return the result of a fit in windows."""
    lines, shots = remark_lines(fitted.remarks), []
    for number, scene in enumerate(fitted.scenes):
        figures = scene.metrics
        lines.append(
            f"{scene.path}: frames {scene.picked} in {scene.windows} windows, {scene.static:,} static and"
            f" {scene.dynamic:,} dynamic Gaussians, PSNR of used frames {figures['used_psnr']:.2f} dB"
        )
        if "seam_psnr" in figures:
            lines[-1] += f" ({figures['seam_psnr']:.2f} dB where windows meet, {figures['rest_psnr']:.2f} dB elsewhere)"
        lines += closing_lines(scene.path.parent, scene.needs, figures)
        added = added_to(fitted, number)
        lines += [each.pop("text") for each in added.values()]
        shots.append(scene.to_json() | added)
    main = fitted.main
    return {
        "scene": str(fitted.path),
        "frames": len(main),
        "width": main.size[0],
        "height": main.size[1],
        "metrics": main.metrics,
        "quality": fitted.quality,
        "needs": [*main.needs],
        "shots": shots,
        "cuts": [*(fitted.cuts or ())],
        **({"note": fitted.notes[-1]} if fitted.notes else {}),
        "text": "\n".join([*lines, *(f"! {note}" for note in fitted.notes)]),
    }


def added_to(fitted: Fitted, number: int) -> dict[str, dict[str, Any]]:
    """Return further results of scene `number`, those of `f4x distill` and `f4x refit`, with their text."""
    added = {"features": distilled_result(fitted.features[number])} if fitted.features else {}
    return added | ({"linear_light": refitted_result(fitted.linear_light[number])} if fitted.linear_light else {})


def remark_lines(remarks: Iterable[Remark]) -> list[str]:
    """Return the lines for the terminal of what was left out, mended or guessed while a clip was read."""
    return [f"! {remark}" for remark in remarks]


def _summary(scene: FittedScene) -> list[str]:
    """Return the content of a scene, its quality and what the clip needed, in lines."""
    (width, height), figures = scene.size, scene.metrics
    lines = [
        f"{scene.path}: {scene.static:,} static and {scene.dynamic:,} dynamic Gaussians"
        f" from {len(scene)} frames of {width}x{height} pixels"
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
    return [*lines, f"what the clip needed: {needs_in_words(scene.needs)}"]
