"""Long clips: shots, then overlapping windows that are fitted one after the other and joined into one scene.

Memory holds one window at a time, in a process of its own (`window`). Each window continues the one before
(`previous_window`): it uses the same world frame, starts with its background and knows its nodes. Its result is an ordinary
scene in `windows/NNN/scene.f4x`.
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..clip import Clip
from ..evaluation.evaluate import evaluate, keep_measured, summary
from ..files import replace_file
from ..fit.config import FitConfig
from ..fit.covered import completed
from ..fit.tints import Tinting
from ..parallel import side_by_side
from ..progress import Progress, silent
from ..report.fitted import FittedScene
from ..scene import Scene, read_scene
from .closing import close_shot
from .join import join_scenes
from .plan import Shot
from .window import SCENE, WindowBefore, WindowRequest, fit_apart, masks_of, near_path

FitWindow = Callable[[Path, Progress], None]
"""Fits the window of a request file (`window`)."""


@dataclass(frozen=True)
class LongFit:
    """The fit of a long clip."""

    read: Callable[[int, int], Clip]
    """`read(start, end)` gives those frames as a clip."""
    config: FitConfig
    """Settings of all windows."""
    resume: bool = False
    """Windows that are finished are kept."""
    fit: FitWindow | None = fit_apart
    """Fits a window; None: all are finished."""


def fit_shot(shot: Shot, how: LongFit, folder: Path, progress: Progress = silent) -> Scene:
    """Fit the windows of a shot one after the other and return the joined scene, which has no metrics yet.

    Every window leaves its scene in `folder/windows`. F4xError where settings, pictures or the windows before are not what
    they were.
    """
    config = how.config
    paths, picked, believed, times = [], [], [], np.zeros(shot.end - shot.start)
    before: WindowBefore | None = None
    for number, (start, end) in enumerate(shot.windows):
        place = (folder / "windows" / f"{number:03d}").absolute()
        clip = how.read(start, end)
        clip.require_enough()
        first = start - shot.start  # what it shares with the window before gets the same times again
        times[first : first + len(clip)] = times[first] + clip.times
        picked.append(clip.picked.split(":"))
        request = WindowRequest(clip, place, config, before, how.resume)
        file = None if request.finished() else request.write()
        del clip, request  # pictures of a window are held once: where they are fitted
        if file is not None:
            assert how.fit is not None
            try:
                how.fit(file, _part_progress("window", number, len(shot.windows), progress))
            finally:
                file.unlink()
        paths.append(place / SCENE)
        scene = read_scene(paths[-1])
        believed.append(scene.provenance.get("believed_degrees"))
        if number + 1 < len(shot.windows):
            before = WindowBefore.of(scene, paths[-1], shot.windows[number + 1][0] - start)
            # One lens films all windows, and their colours are of one degree.
            focal = float(scene.cameras.intrinsics[0, 0, 0]) / scene.cameras.width
            cameras = replace(config.priors.cameras, focal=focal)
            config = replace(config, priors=replace(config.priors, cameras=cameras), sh_degree=scene.sh_degree)
        del scene
    local = [(a - shot.start, b - shot.start) for a, b in shot.windows]
    joined = join_scenes((read_scene(path) for path in paths), local, config.backend, progress, times)
    provenance = {name: value for name, value in joined.provenance.items() if name != "window"}
    provenance |= {"windows": local, "frames": ":".join([picked[0][0], *picked[-1][1:]])}
    provenance["believed_degrees"] = min((degrees for degrees in believed if degrees is not None), default=None)
    need = {
        "what": "windows",
        "chosen": str(len(shot.windows)),
        "evidence": f"{shot.end - shot.start} frames, at most {max(b - a for a, b in shot.windows)} at a time",
        "saved": "memory that grows with the clip",
    }
    whole = completed(replace(joined, provenance=provenance, needs=(need,)))
    return _with_tints(whole, shot, how, folder, progress)


def _with_tints(scene: Scene, shot: Shot, how: LongFit, folder: Path, progress: Progress) -> Scene:
    """Return the joined scene with colors over time, if they pay; frames are read one window at a time, each once."""
    config = how.config
    if not config.tints.enabled:
        return scene
    starts = [start for start, _ in shot.windows]
    with side_by_side(config.kernels.threads):
        tinting = Tinting(scene, config.tints, config.backend)
        for number, (start, end) in enumerate(pairwise([*starts, shot.end])):
            tell = _part_progress("window", number, len(starts), progress)
            masks = masks_of(folder / "windows" / f"{number:03d}")
            tinting.add(how.read(start, end), masks, start - shot.start, tell)
        return tinting.finish()


def _part_progress(what: str, number: int, count: int, progress: Progress) -> Progress:
    """Return a `Progress` for one of several shots or windows, whose messages name the number of the part."""
    if count == 1:
        return progress

    def tell(stage: str, done: int, total: int, message: str = "") -> None:
        progress(stage, done, total, f"{what} {number + 1} of {count}" + (f", {message}" if message else ""))

    return tell


def evaluate_shot(
    scene: Scene, shot: Shot, read: Callable[[int, int], Clip], backend: str = "auto", progress: Progress = silent
) -> dict[str, Any]:
    """Return the figures of `evaluation.evaluate.evaluate` for the joined scene, read one window at a time, and those of its seams.

    `seam_psnr` and `rest_psnr` (dB) are means over the used frames that two windows share and over the others.
    """
    frames: list[dict[str, Any]] = []
    shared = np.zeros(shot.end - shot.start, bool)
    for (_, end), (start, _) in pairwise(shot.windows):
        shared[start - shot.start : end - shot.start] = True
    for number, (start, _) in enumerate(shot.windows):
        end = shot.windows[number + 1][0] if number + 1 < len(shot.windows) else shot.end
        first, past = start - shot.start, end - shot.start
        path = scene.cameras
        cameras = replace(
            path,
            intrinsics=path.intrinsics[first:past],
            world_to_camera=path.world_to_camera[first:past],
            times=path.times[first:past],
        )
        held_out = tuple(frame - first for frame in scene.held_out if first <= frame < past)
        part = replace(scene, cameras=cameras, held_out=held_out)
        metrics = evaluate(
            near_path(part),
            read(start, end),
            backend=backend,
            progress=_part_progress("window", number, len(shot.windows), progress),
        )
        frames += [row | {"frame": row["frame"] + first} for row in metrics["frames"]]
    figures = {"frames": frames, **summary(frames)}
    if shared.any():
        used = [(row["psnr"], shared[row["frame"]]) for row in frames if not row["held_out"]]
        figures["seam_psnr"] = float(np.mean([value for value, at_seam in used if at_seam]))
        figures["rest_psnr"] = float(np.mean([value for value, at_seam in used if not at_seam]))
    return figures


def fit_long(shots: Sequence[Shot], how: LongFit, folder: Path, progress: Progress = silent) -> list[FittedScene]:
    """Fit every shot: `folder/scene.f4x`, `metrics.json` and `diagnostics.html`, or those in `folder/shot_N` where the clip is
    cut, with a `folder/diagnostics.html` that leads to them.

    Returns a scene for each shot, whose metrics have what `close_shot` tells.
    """
    results = []
    for number, shot in enumerate(shots):
        place = folder if len(shots) == 1 else folder / f"shot_{number + 1}"
        one = _part_progress("shot", number, len(shots), progress)
        scene = fit_shot(shot, how, place, one)
        metrics = evaluate_shot(scene, shot, how.read, how.config.backend, one)
        local = [(start - shot.start, end - shot.start) for start, end in shot.windows]
        closing = close_shot(place, scene, local, metrics)
        scene, figures = keep_measured(place, scene, metrics, **closing)
        results.append(FittedScene.of(place / "scene.f4x", scene, figures, (shot.start, shot.end), len(shot.windows)))
    if len(shots) > 1:
        _write_contents(folder, scene.name, results)
    return results


def _write_contents(folder: Path, title: str, results: Sequence[FittedScene]) -> None:
    """Write `diagnostics.html` of a clip with cuts: links to the pages of its shots."""
    from .. import page

    lines = [
        f'<p><a href="shot_{number}/diagnostics.html">shot {number}</a>: frames {shot.picked} of the source,'
        f" PSNR {shot.metrics.get('used_psnr', math.nan):.2f} dB. {html.escape(shot.metrics['verdict'])}</p>"
        for number, shot in enumerate(results, 1)
    ]
    with replace_file(folder / "diagnostics.html") as file:
        file.write(page.document(title, [page.section("Shots, each a scene of its own", "".join(lines))]))
