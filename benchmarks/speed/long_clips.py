"""Cost of a clip's length: `f4x bench scale --long`. Memory, time and seams of one clip played to and fro."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from f4x_core.clip.images import list_images
from f4x_core.errors import F4xError
from f4x_core.processes import run_child
from f4x_core.progress import Progress, silent

from .batch import make_clip

WIDTH, HEIGHT = 240, 136
"""Pixels of the measurement."""
WINDOW = 60
"""Frames of a window."""
MADE_UP = 60
"""Frames of the made-up clip before it is played to and fro."""


def play_to_and_fro(source: Path, target: Path, frames: int) -> None:
    """Write so many pictures of the folder `source` into `target`, forwards and backwards by turns; no turn doubles a frame."""
    files = list_images(source)
    if len(files) < 2:
        raise F4xError(f"{source} holds {len(files)} pictures; give a folder with two or more.")
    target.mkdir(parents=True, exist_ok=True)
    for number, file in enumerate(islice(cycle([*files, *files[-2:0:-1]]), frames)):
        shutil.copyfile(file, target / f"{number:05d}{file.suffix}")


def measure_long(
    folder: Path, counts: Sequence[int], source: Path | None = None, progress: Progress = silent
) -> dict[str, Any]:
    """Fit the first of `counts` frames, then each larger number, in processes of their own (profile `quick`, one thread).

    `source`: a folder of pictures; a made-up clip without it. A row that is finished stays in `folder` and is not measured again;
    one that was cut off begins anew, for half a fit tells neither time nor memory. Returns rows of `frames`, `memory_mb` (largest
    resident set), `cpu_s`, `cpu_s_per_frame`, `static` (Gaussians), `used_psnr`, `seam_psnr`, `rest_psnr`, and by the last row
    against the first `memory_ratio` and `time_ratio` (per frame), and the largest `seam_loss` (dB).
    """
    known = "made up" if source is None else str(source.resolve())
    if source is None:
        source = folder / "made_up"
        make_clip(source, MADE_UP, WIDTH, HEIGHT, seed=0)
    rows: list[dict[str, Any]] = []
    for count in counts:
        progress("bench scale", len(rows), len(counts), f"{count} frames")
        clip, place, record = folder / f"clip{count}", folder / f"fit{count}", folder / f"row{count}.json"
        if record.is_file() and (row := json.loads(record.read_text(encoding="utf-8")))["source"] == known:
            rows.append(row)
            continue
        for left in (clip, place):
            shutil.rmtree(left, ignore_errors=True)
        play_to_and_fro(source, clip / "images", count)
        options = ["--window", str(WINDOW), "--profile", "quick", "--threads", "1", "--width", str(WIDTH)]
        command = [sys.executable, "-m", "f4x_core", "fit", str(clip), "-o", str(place), *options, "--progress-json"]
        ended = run_child(command, Path.cwd(), progress, variables={"OMP_NUM_THREADS": "1"})
        if ended.code:
            raise F4xError(f"{clip}: fitting {count} frames failed: {ended.last.get('error') or ended.tail}")
        figures = json.loads((place / "metrics.json").read_text(encoding="utf-8"))
        row = {
            "source": known,
            "frames": count,
            "memory_mb": ended.memory / 1e6,
            "cpu_s": ended.cpu_seconds,
            "cpu_s_per_frame": ended.cpu_seconds / count,
            "static": ended.last["result"]["shots"][0]["static"],
        }
        row |= {name: figures[name] for name in ("used_psnr", "seam_psnr", "rest_psnr") if name in figures}
        record.write_text(json.dumps(row), encoding="utf-8")
        rows.append(row)
    return {
        "rows": rows,
        "memory_ratio": rows[-1]["memory_mb"] / rows[0]["memory_mb"],
        "time_ratio": rows[-1]["cpu_s_per_frame"] / rows[0]["cpu_s_per_frame"],
        "seam_loss": max(row["rest_psnr"] - row["seam_psnr"] for row in rows if "seam_psnr" in row),
    }
