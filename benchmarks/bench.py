"""`f4x bench`."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from fnmatch import fnmatchcase
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f4x_core.errors import F4xError
from f4x_core.progress import Progress

if TYPE_CHECKING:
    from f4x_core.clip import Clip
    from f4x_core.scene import Scene

TABLE_WIDTH = 100
"""Characters of a line in the table of `bench features`, wherever it is printed to."""


def run_bench(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Speed against error of the raster backends or of the scaffold's deformation; what a step of the fit is made of; how well a
    scene answers and is edited; or what a batch costs."""
    if args.what == "scale":
        return _scale(args, progress)
    for name in ("counts", "threads", "repeats"):
        value = getattr(args, name)
        if min(value if isinstance(value, list) else [value]) < 1:
            raise F4xError(f"--{name} {value}: give numbers from 1 on.")
    import torch

    torch.set_num_threads(1)  # threads are the backends' own, so that one thread means one
    benches = {"raster": _raster, "deform": _deform, "step": _step}
    return (benches | {"features": _features, "edit": _edit, "select": _select})[args.what](args, progress)


def _raster(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from .speed.raster import Cases, benchmark, compare_decoding, measure_memory, measure_thread_ceiling

    cases = Cases(tuple(args.counts), threads=tuple(args.threads))
    report = benchmark(cases, repeats=args.repeats, progress=progress)
    progress("bench raster", 0, 0, "latent, memory and threads")
    decoding, memory = compare_decoding(repeats=args.repeats), measure_memory()
    report |= {"decoding": decoding, "memory_mb": memory, "thread_ceiling": measure_thread_ceiling()}
    lines = [f"{report['width']}x{report['height']}, medians of {args.repeats} interleaved runs"]
    for row in report["timings"]:
        line = (
            f"{row['backend']:<7} {row['gaussians']:>9,} Gaussians {row['channels']:>3} channels {row['threads']} threads:"
            f" {row['forward_ms']:7.1f} ms forward, {row['train_ms']:7.1f} ms with backward"
        )
        if "peak_fraction" in row:
            line += (
                f", {row['pairs_per_pixel']:.0f} pairs per pixel, {100 * row['peak_fraction']:.1f} % of the FMA peak"
            )
        lines.append(line)
    lines += [f"{value:5.2f}  {name}" for name, value in report["ratios"].items()]
    for name, error in report["errors"].items():
        worst = max(error["gradients"].items(), key=lambda item: item[1])
        lines.append(f"{name}: image error {error['image_max']:.1e}, worst gradient {worst[0]} {worst[1]:.1e}")
    lines.append(
        f"{decoding['ratio']:5.2f}  512 channels rendered ({decoding['rendered_ms']:.0f} ms) / 32 rendered and decoded"
        f" ({decoding['decoded_ms']:.0f} ms)"
    )
    if report["thread_ceiling"] is not None:
        lines.append(f"{report['thread_ceiling']:5.2f}  the most that two threads can gain on this machine")
    if memory is not None:
        lines.append(f"200,000 Gaussians with 35 channels: peak memory grows by {memory:.0f} MB")
    lines += [f"{name} skipped: {reason}" for name, reason in report["skipped"].items()]
    return {**report, "text": "\n".join(lines)}


def _deform(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from .speed.deformation import benchmark

    report = benchmark(tuple(args.counts), repeats=args.repeats, progress=progress)
    lines = [f"medians of {args.repeats} interleaved runs, one thread"]
    for row in report["timings"]:
        lines.append(f"{row['gaussians']:>9,} Gaussians x {row['neighbours']}: {row['name']:<22} {row['ms']:7.1f} ms")
    lines += [f"{value:5.2f}  {name}" for name, value in report["ratios"].items()]
    lines += [f"{name}: largest error {error:.1e}" for name, error in report["errors"].items()]
    return {**report, "text": "\n".join(lines)}


def _step(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from f4x_core.clip import read_clip

    from .speed.step import profile_steps

    if args.clip is None:
        raise F4xError("bench step needs --clip CLIP: the clip that is fitted.")
    clip = read_clip(args.clip, args.frames, progress=progress)
    with tempfile.TemporaryDirectory() as place:
        report = profile_steps(clip, args.folder or Path(place), "quick", progress)
    lines = [
        f"{report['gaussians']:,} Gaussians at {report['width']}x{report['height']}, one thread; milliseconds",
        f"{'':<28} {'all':>7} {'shareable':>10} {'serial':>7}",
    ]
    for row in (*report["parts"], report["step"], report["actions"]):
        lines.append(f"{row['part']:<28} {row['ms']:7.2f} {row['shareable_ms']:10.2f} {row['serial_ms']:7.2f}")
    return {**report, "text": "\n".join(lines)}


REACH = {
    "size_ratio": "<= 1.2",
    "psnr_change": "|.| < 0.1",
    "fit_ratio": "<= 1.6",
    "width_ratio": "Feature4X: 5.23",
    "mask_time_ratio": ">= 3",
    "sentence_s": "<= 5",
    "still_flicker": "<= 1.05",
    "mask_iou": ">= 0.8",
    "point_iou": ">= 0.8",
    "mask_leakage": "< 0.02",
    "point_leakage": "< 0.02",
    "two_workers_gain": ">= 1.8",
    "local_overhead_s": "<= 0.2",
    "ray_overhead_s": "<= 1",
    "cost_error_most": "|.| <= 0.25",
    "memory_ratio": "<= 1.3",
    "time_ratio": "0.85 to 1.15",
    "seam_loss": "<= 0.5",
} | {
    f"{prompt}_{edit}_{figure}_{kind}": wanted
    for prompt in ("mask", "point", "moving")
    for edit in ("delete", "recolour")
    for figure, wanted in (("iou", ">= 0.85"), ("leakage", "< 0.02"))
    for kind in ("original", "novel")
}
"""Goals of the figures of `bench features`, `bench edit` and `bench scale`, for the table."""
MEANING = {
    "gaussians": "Gaussians of the scene",
    "open_s": "seconds to open the file",
    "propose_s": "seconds to understand the sentence and look its words up",
    "apply_s": "seconds to write the edit into the file",
    "sentence_s": "seconds from the sentence to the edited file: the two before",
    "still_flicker": "what stands still is painted: flicker after / before, 1 = none is added",
    "mask_*": "the thing is chosen by its true mask on one frame …",
    "point_*": "… by a click into its middle",
    "text_*": "… by the word",
    "moving_*": "… as what moves",
    "best_*": "… as well as whole Gaussians can",
    "*_delete_*": "it is deleted (else it is dyed)",
    "*iou*": "changed pixels against the true masks: shared / all of both, 1 = the same",
    "*iou_worst*": "… on the worst frame",
    "*coverage*": "share of the true mask that changed",
    "*leakage*": "share of all change that lies outside the true mask and a thin rim",
    "*leakage_strict*": "… without the rim",
    "*_original": "seen by the clip's own cameras",
    "*_novel": "seen by cameras that the fit never saw",
}
"""Meanings of the figures of `bench edit`, by patterns of their names."""


def _features(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from f4x_core.app.distilling import clip_of_scene
    from f4x_core.app.selecting import read_masks
    from f4x_core.query.labels import encode_labels
    from f4x_core.query.smoothing import LOOKS_ALIKE
    from f4x_core.scene import read_scene

    from .quality.queries import benchmark, measure_cost
    from .speed.feature_cost import compare_inference

    if args.scene is None:
        raise F4xError("bench features needs --scene SCENE, and --masks, --clip or --times for more.")
    report: dict[str, Any] = {}
    scene = read_scene(args.scene)
    if args.masks is not None:
        masks = read_masks(args.masks, scene)
        report |= benchmark(scene, masks, args.label, encode_labels, repeats=args.repeats, progress=progress)
        if LOOKS_ALIKE in scene.require_field().names:
            first = min(masks)
            report |= compare_inference(scene, masks[first], first, LOOKS_ALIKE, progress=progress)
    else:
        report |= {"scene": scene.name} | measure_cost(scene, repeats=args.repeats)
    if args.truth is not None:
        if args.label is None:
            raise F4xError("--truth needs --label WORD: what moves in the rendered clip.")
        from .quality.labels import score_labels

        report |= score_labels(scene, args.truth, args.label, encode=encode_labels, progress=progress)
    if args.times and args.clip is None:
        raise F4xError("--times needs --clip CLIP: the clip is fitted anew.")
    if args.clip is not None:
        clip = clip_of_scene(scene, args.clip, args.frames, progress)
        report |= _images(scene, clip, args, progress)
        report |= _times(scene, clip, args, progress) if args.times else {}
    return {**report, "text": _as_table(report)}


def _select(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from f4x_core.app.selecting import read_masks
    from f4x_core.edit.apply import open_scene
    from f4x_core.query.labels import encode_labels

    from .quality.selecting import PUBLISHED, score_selecting, score_things
    from .quality.touching import score_clicks

    if args.scene is None:
        rows = score_clicks(args.seeds, progress)
        lines = [
            f"{row['scene']:<8} {row['clicks']:3d} clicks: IoU {row['IoU']:.2f}, worst {row['worst IoU']:.2f}"
            for row in rows
        ]
        return {"touching": rows, "text": "\n".join(lines)}
    scene = open_scene(args.scene)
    report: dict[str, Any] = {}
    lines = []
    if args.masks is not None:
        masks = read_masks(args.masks, scene)
        report["ways"] = score_selecting(scene, masks, args.label, encode_labels, progress=progress)
        for name, row in report["ways"].items():
            figures = ", ".join(f"{key} {row[key]:.3f}" for key in ("J", "F", "worst J", "seconds") if key in row)
            lines.append(f"{name:<18} {figures or row['refused']}")
        published = ", ".join(f"{name} {value:.3f} ({source})" for name, (value, source) in PUBLISHED.items())
        lines.append(f"mean J of others on DAVIS 2016's validation clips, from the first frame's mask: {published}")
    if args.things is not None:
        report["things"] = list(score_things(scene, args.things, scene.name))
        lines += [
            f"{row['thing']:<18} " + ", ".join(f"{name} {row[name]:.3f}" for name in ("click", "three clicks", "box"))
            for row in report["things"]
        ]
    if not lines:
        raise F4xError(
            "With --scene give --masks DIR, --things FILE or both; without --scene made-up scenes are measured."
        )
    return {**report, "text": "\n".join(lines)}


def _edit(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from f4x_core.app.selecting import read_masks
    from f4x_core.edit.apply import open_scene
    from f4x_core.query.labels import encode_labels
    from f4x_core.scene import read_scene

    from .quality.edits import benchmark, try_faults

    report: dict[str, Any] = {}
    if args.scene is not None:
        masks = None if args.masks is None else read_masks(args.masks, read_scene(args.scene))
        named = args.label if args.truth is None else None  # with a truth it is a prompt, which may find nothing
        report |= benchmark(args.scene, masks, named, encode_labels, progress=progress)
        if args.truth is not None:
            from .quality.edits_against_truth import score_edits

            report |= score_edits(
                open_scene(args.scene), args.truth, args.label, encode=encode_labels, progress=progress
            )
    elif args.truth is not None:
        raise F4xError("--truth needs --scene SCENE: the scene that was made from the rendered clip.")
    progress("bench edit", 0, 0, "a server that fails")
    messages = try_faults()
    lines = [f"a server that fails ({fault}): {sentence}" for fault, sentence in messages.items()]
    table = _as_table(report) + "\n\n" + _meanings(report) if report else ""
    return {**report, "endpoint_faults": messages, "text": "\n\n".join(filter(None, [table, "\n".join(lines)]))}


def _meanings(report: dict[str, Any]) -> str:
    """One line for each kind of figure in a report of `bench edit`."""
    patterns = [pattern for pattern in MEANING if any(fnmatchcase(name, pattern) for name in report)]
    width = max(map(len, patterns))
    return "\n".join(f"{pattern:<{width}}  {MEANING[pattern]}" for pattern in patterns)


def _scale(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from .speed.batch import SIZES, benchmark

    if args.long is not None:
        return _long(args, progress)
    if not 0 <= args.clips <= len(SIZES):
        raise F4xError(f"--clips {args.clips}: give a number from 0 to {len(SIZES)}.")
    report = benchmark(args.clips, progress)
    if report.get("cost_errors"):
        report["cost_error_most"] = max(report["cost_errors"], key=abs)
    return {**report, "text": _as_table({name: value for name, value in report.items() if not isinstance(value, list)})}


def _long(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """A clip played to and fro, short and long."""
    from .speed.long_clips import WINDOW, measure_long

    counts = sorted({*args.long})
    if len(counts) < 2 or counts[0] <= WINDOW:
        raise F4xError(
            f"--long {' '.join(map(str, args.long))}: give two numbers of frames above {WINDOW}, e.g. 200 1000."
        )
    with tempfile.TemporaryDirectory() as place:
        report = measure_long(args.folder or Path(place), counts, args.clip, progress)
    lines = [
        f"{row['frames']:>6} frames: {row['memory_mb']:5.0f} MB, {row['cpu_s_per_frame']:5.2f} s of one core a frame, PSNR"
        f" {row['seam_psnr']:.2f} dB where windows meet, {row['rest_psnr']:.2f} dB elsewhere"
        for row in report["rows"]
    ]
    return {**report, "text": "\n".join([*lines, _as_table({n: v for n, v in report.items() if n != "rows"})])}


def _images(scene: Scene, clip: Clip, args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Scores of renders with features against renders of the scene without them."""
    from f4x_core.scene import read_scene

    from .speed.feature_cost import compare_renders

    scene.require_field()
    plain = read_scene(args.plain) if args.plain is not None else replace(scene, features=None)
    return compare_renders(scene, plain, clip, progress=progress)


def _times(scene: Scene, clip: Clip, args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """A `quick` fit from the frames on, and distilling the scene's teachers into it."""
    from f4x_core.app.distilling import maps_of
    from f4x_core.fit.config import profile
    from f4x_core.fit.distil_config import DistilConfig
    from f4x_core.fit.pipeline import fit_clip

    from .speed.feature_cost import measure_times

    folder = args.features or args.scene.parent / "features"
    maps = [maps_of(scene, folder / name, name, clip, progress) for name in scene.require_field().names]
    threads = max(args.threads)
    with tempfile.TemporaryDirectory() as place:

        def fit() -> Scene:
            config = replace(profile("quick"), threads=threads)
            return fit_clip(clip, Path(place), config, progress).scene

        return measure_times(fit, maps, DistilConfig(threads=threads), args.repeats, progress)


def _as_table(report: dict[str, Any]) -> str:
    """Name, value and goal in columns."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, show_header=True, pad_edge=False)
    for title in ("", "measured", "to reach"):
        table.add_column(title, justify="right" if title == "measured" else "left")
    for name, value in report.items():
        if not isinstance(value, dict):
            shown = f"{value:.4g}" if isinstance(value, float) else str(value)
            table.add_row(name, shown, REACH.get(name, ""))
    text = StringIO()
    Console(file=text, width=TABLE_WIDTH).print(table)
    return text.getvalue().rstrip()
