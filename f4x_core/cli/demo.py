"""`f4x demo`: from a rendered clip, or your own video, to a Blender file."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..app.fitting import fit_at_once, require_settings
from ..app.paths import times_of
from ..clip import Clip
from ..clip.rendered_scenes import ALL, scenes_named
from ..clip.video import write_video
from ..errors import F4xError
from ..evaluation.contact_sheet import contact_sheet
from ..evaluation.truth import score_against_truth
from ..files import json_text, replace_file
from ..geometry import trajectory
from ..geometry.trajectory import Trajectory
from ..progress import Progress
from ..reading import load_json
from ..scene import Scene, read_scene
from ..scene.view import render_trajectory
from .fitting import clip_options_of, config_of, result_at_once

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
# Size of the new path (degrees): a circle seen that far from the middle camera, and the sheet's step to the side.
ORBIT_DEGREES = 5.0
# What the render writes; a new render first removes these, and nothing else, from the clip's folder.
RENDERED = ("images", "truth", "images_left10", "images_right10", "truth.json")
# Degrees of the extra cameras to the left and right of the camera path.
EXTRA = "10"
# File with the settings of a finished render, so that a call with equal settings can reuse the clip.
SETTINGS = "rendered.json"
# Seconds between two checks of a child process.
POLL_SECONDS = 0.5


@dataclass(frozen=True)
class DemoClip:
    """The rendered clip: short and small enough for two cores and ten minutes."""

    scene: str = "procedural"
    """Name of the scene that `scripts/synthetic_clip.py` builds."""
    frames: int = 30
    """Clip frames."""
    size: str = "288x162"
    """Pixels."""
    samples: int = 16
    """Cycles samples per pixel."""
    seed: int = 0
    """Camera jitter and furniture."""

    def arguments(self) -> list[str]:
        """Return the settings as command-line arguments of the script."""
        return [text for name, value in asdict(self).items() for text in (f"--{name}", str(value))]


def run_demo(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Leave scene, videos, contact sheet, Blender file and diagnostics page in the output folder, and say how good it is.

    Raises:
        F4xError: unreadable clip; without `--clip`, a place without the repository's scripts or without bpy.
    """
    start = time.perf_counter()
    folder, config = Path(args.output), config_of(args)
    require_settings(config)
    rendered = args.clip is None
    if rendered:
        if args.frames is not None:
            raise F4xError("--frames chooses from your own video; give --clip VIDEO with it.")
        if args.scene == ALL:
            raise F4xError(f"--scene {ALL}: the demo makes one scene; name one.")
        scenes_named([args.scene])  # an unknown name is refused before anything is rendered
        render_clip(folder / "clip", DemoClip(args.scene, seed=args.seed), progress)
        args.clip = str(folder / "clip" / "images")
    clip = clip_options_of(args).read(args.clip, progress)
    fitted = result_at_once(fit_at_once(clip, folder, config, progress))
    scene = read_scene(fitted["scene"])
    made = ["scene.f4x", "diagnostics.html", *write_renders(folder, scene, clip, args.backend, progress)]
    lines = [fitted["text"]]
    scores: dict[str, Any] = {}
    if rendered:
        scores = score_against_truth(
            scene, folder / "clip", refine_camera=True, backend=args.backend, progress=progress
        )
        with replace_file(folder / "scores.json") as file:
            file.write(json_text(scores, indent=1).encode())
        lines += score_lines(scores)
        made.append("scores.json")
    if importlib.util.find_spec("bpy") is None:
        lines.append("scene.blend was left out: this Python has no bpy; Blender opens scene.f4x by its own import.")
    else:
        run_script("import_scene.py", fitted["scene"], str(folder / "scene.blend"))
        made.append("scene.blend")
    seconds = time.perf_counter() - start
    lines.append(f"{folder} holds {', '.join(made)}; all of it took {seconds / 60:.1f} minutes")
    return {
        "output": str(folder),
        "files": made,
        "metrics": fitted["metrics"],
        "scores": {name: value for name, value in scores.items() if name != "views"},
        "seconds": round(seconds, 1),
        "text": "\n".join(lines),
    }


def render_clip(folder: Path, settings: DemoClip, progress: Progress) -> None:
    """Render the clip and its truth into `folder`, unless a finished one with equal settings is there."""
    wanted = asdict(settings)
    done = folder / SETTINGS
    with contextlib.suppress(OSError, ValueError):
        if load_json(done) == wanted:
            return
    done.unlink(missing_ok=True)
    for name in RENDERED:
        place = folder / name
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)

    def look() -> None:
        count = len(list((folder / "images").glob("*.png")))
        progress("render clip", count, settings.frames)

    run_script("synthetic_clip.py", str(folder), *settings.arguments(), "--extra-cameras", EXTRA, look=look)
    look()
    with replace_file(done) as file:
        file.write(json.dumps(wanted).encode())


def run_script(name: str, *arguments: str, look: Callable[[], None] = lambda: None) -> None:
    """Run one of the repository's scripts in its own Python process, calling `look` now and then.

    Raises:
        F4xError: the scripts are missing, or the script failed (with the last line of its output).
    """
    script = SCRIPTS / name
    if not script.is_file():
        raise F4xError(f"{script} is not there: the demo needs a checkout of the repository, not only the package.")
    command = [sys.executable, str(script), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as child:
        try:
            output = _wait_for_output(child, look)
        except BaseException:
            child.terminate()
            raise
    if child.returncode:
        raise F4xError(f"{name} failed: {output.strip().splitlines()[-1] if output.strip() else 'it printed nothing'}")


def _wait_for_output(child: subprocess.Popen[str], look: Callable[[], None]) -> str:
    """Wait until the child ends, calling `look` now and then, and return its whole output."""
    output = io.StringIO()
    while True:
        look()
        try:
            output.write(child.communicate(timeout=POLL_SECONDS)[0])
            return output.getvalue()
        except subprocess.TimeoutExpired:
            continue


def write_renders(folder: Path, scene: Scene, clip: Clip, backend: str, progress: Progress) -> list[str]:
    """Write the videos of the original and of a new path and the contact sheet; return their names."""
    paths: dict[str, Trajectory] = {
        "original": trajectory.original(scene.cameras),
        "orbit": trajectory.orbit(scene.cameras, degrees=ORBIT_DEGREES),
    }
    for name, path in paths.items():
        views = render_trajectory(scene, path, ("rgb",), backend, progress=progress)
        write_video(folder / f"{name}.mp4", (view["rgb"] for view in views), scene.fps, times_of(scene, name))
    sheet = contact_sheet(scene, clip, backend=backend, progress=progress)
    with replace_file(folder / "contact_sheet.png") as file:
        sheet.save(file, "PNG")
    return [*(f"{name}.mp4" for name in paths), "contact_sheet.png"]


def score_lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores against the truth as lines of text."""
    lines = [
        "against the truth, which the fit never saw:",
        f"  camera path off by {scores['ate_fraction']:.2%} of its length, {scores['rotation_error']:.2f}° in direction",
    ]
    if "unseen_psnr" in scores:
        lines += [
            f"  two cameras 10° off the path: {scores['unseen_psnr']:.2f} dB, SSIM {scores['unseen_ssim']:.3f}"
            f" over {len(scores['views'])} pictures",
            f"  of these, what the clip did see ({scores['unseen_covered_fraction']:.0%} of the pixels):"
            f" {scores['unseen_psnr_covered']:.2f} dB,"
            f" {scores['unseen_psnr_covered_refined']:.2f} dB with the camera refined on the picture",
        ]
    else:
        lines.append("  views from elsewhere cannot be compared: none was rendered, or the fitted camera stands still")
    return lines
