"""`f4x distill`."""

from __future__ import annotations

import argparse
import os
from typing import Any

from ..app.distilling import Distilled, DistilRequest, distill
from ..errors import F4xError
from ..features.spectrum import WIDTHS
from ..files import user_path
from ..fit.distil_config import DistilConfig
from ..progress import Progress
from .checks import listed_teachers


def run_distill(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Add heads or words to a scene, in place or in another file."""
    names = listed_teachers(args.teacher, "--teacher") if args.teacher is not None else []
    labels = read_labels(args.vocabulary) if args.vocabulary is not None else []
    if not names and not labels:
        raise F4xError("there is nothing to do; give --teacher NAME, --vocabulary WORDS, or both.")
    where = {"folder": args.features, "clip": args.clip, "frames": args.frames, "output": args.output}
    request = DistilRequest(args.scene, tuple(names), tuple(labels), config=config_of(args), **where)
    return distilled_result(distill(request, progress))


def distilled_result(added: Distilled) -> dict[str, Any]:
    """Return the result of the verb."""
    others = sum(added.megabytes.values()) - added.megabytes["features"]
    size = f"+{added.megabytes['features']:.1f} MB ({added.megabytes['features'] / max(others, 1e-9):.0%} of the rest)"
    lines = [f"{added.path}: latent of {added.width} channels, {size}"]
    lines += [f"  {name}: {_head_line(report)}" for name, report in added.heads.items()]
    lines += [f"  {encoder}: {len(words)} labels" for encoder, words in added.vocabularies.items()]
    lines += [
        f"  {encoder}: no labels, that text encoder is not here; later `f4x distill {added.path} --vocabulary WORDS`"
        for encoder in added.wordless
    ]
    if added.kept:
        lines.append(f"  {', '.join(added.kept)}: kept as learnt; --teacher without --vocabulary learns anew")
    return {
        "scene": str(added.path),
        "width": added.width,
        "heads": added.heads,
        "vocabularies": {encoder: list(words) for encoder, words in added.vocabularies.items()},
        "megabytes": added.megabytes,
        "text": "\n".join(lines),
    }


def config_of(args: argparse.Namespace) -> DistilConfig:
    """Return the settings that the arguments give."""
    width = None
    if args.latent_width != "auto":
        if args.latent_width not in map(str, WIDTHS):
            raise F4xError(f"--width {args.latent_width}: give auto, {', '.join(map(str, WIDTHS))}.")
        width = int(args.latent_width)
    if args.steps < 1:
        raise F4xError(f"--steps {args.steps}: give at least 1.")
    return DistilConfig(width=width, steps=args.steps, seed=args.seed, threads=args.threads, backend=args.backend)


def read_labels(text: str) -> list[str]:
    """Return the labels of a file with one per line, or of a list with commas."""
    path = user_path(text)
    is_file = os.path.isfile(path)  # False for a list of words that is longer than a name may be
    if not is_file and (path.suffix.lower() in (".txt", ".csv") or len(path.parts) > 1):
        raise F4xError(f"--vocabulary {text}: there is no such file; check the path, or write words with commas.")
    try:
        words = path.read_text(encoding="utf-8").splitlines() if is_file else text.split(",")
    except (OSError, UnicodeDecodeError) as error:
        raise F4xError(
            f"--vocabulary {text}: cannot be read ({error}); give a text file with one label per line."
        ) from error
    found = [word.strip() for word in words if word.strip()]
    if not found:
        raise F4xError(
            f"--vocabulary {text}: has no label; write words with commas, or a file with one label per line."
        )
    return found


def _head_line(report: Any) -> str:
    parts = [
        f"{title} relative error {report[group]['relative_error']:.1%}, cosine {report[group]['cosine']:.3f}"
        for group, title in (("used", "used frames"), ("held_out", "held-out frames"))
        if group in report
    ]
    if "drift" in report:
        parts.append(f"moved by {report['drift']:.1%} when the last head was added")
    return "; ".join(parts) or "not seen by any camera"
