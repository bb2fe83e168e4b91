"""`f4x bench`."""

from __future__ import annotations

import argparse
from typing import Any

from ..errors import F4xError
from ..progress import Progress


def run_bench(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Speed against error of the raster backends or of the scaffold's deformation; or how well a scene answers."""
    import torch

    torch.set_num_threads(1)  # threads are the backends' own, so that one thread means one
    return {"raster": _raster, "deform": _deform, "features": _features}[args.what](args, progress)


def _raster(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from ..raster.benchmark import benchmark, compare_decoding, measure_memory, measure_thread_ceiling

    report = benchmark(tuple(args.counts), threads=tuple(args.threads), repeats=args.repeats, progress=progress)
    progress("bench raster", 0, 0, "latent, memory and threads")
    decoding, memory = compare_decoding(repeats=args.repeats), measure_memory()
    report |= {"decoding": decoding, "memory_mb": memory, "thread_ceiling": measure_thread_ceiling()}
    lines = [f"{report['width']}x{report['height']}, medians of {args.repeats} interleaved runs"]
    for row in report["timings"]:
        line = (
            f"{row['backend']:<7} {row['gaussians']:>9,} Gaussians {row['channels']:>3} channels {row['threads']} threads:"
            f" {row['forward_ms']:7.1f} ms forward, {row['train_ms']:7.1f} ms with backward"
        )
        if "peak_share" in row:
            line += f", {row['pairs_per_pixel']:.0f} pairs per pixel, {100 * row['peak_share']:.1f} % of the FMA peak"
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
    from ..scaffold.benchmark import benchmark

    report = benchmark(tuple(args.counts), repeats=args.repeats, progress=progress)
    lines = [f"medians of {args.repeats} interleaved runs, one thread"]
    for row in report["timings"]:
        lines.append(f"{row['gaussians']:>9,} Gaussians x {row['neighbours']}: {row['name']:<22} {row['ms']:7.1f} ms")
    lines += [f"{value:5.2f}  {name}" for name, value in report["ratios"].items()]
    lines += [f"{name}: largest error {error:.1e}" for name, error in report["errors"].items()]
    return {**report, "text": "\n".join(lines)}


def _features(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from ..query.benchmark import benchmark
    from ..query.labels import encode_labels
    from ..scene import read_scene
    from .querying import read_masks

    if args.scene is None or args.masks is None:
        raise F4xError("bench features needs --scene SCENE and --masks DIR, and --label WORD to measure words.")
    scene = read_scene(args.scene)
    masks = read_masks(args.masks, scene)
    report = benchmark(scene, masks, args.label, encode_labels, repeats=args.repeats, progress=progress)
    lines = [
        f"{name}: {value:.3f}" if isinstance(value, float) else f"{name}: {value}" for name, value in report.items()
    ]
    return {**report, "text": "\n".join(lines)}
