"""One picture that shows a scene: input, render, a new view, depth and motion of a few moments."""

from __future__ import annotations

import numpy as np
from PIL import Image

from ..clip import Clip
from ..clip.images import as_bytes
from ..errors import F4xError
from ..geometry import trajectory
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.picture import colour_depth, colour_motion, depth_range, labelled_grid
from ..scene.view import render

COLUMNS = ("input", "render", "new view", "depth", "motion")
# How far the new view is turned to the side, seen from the scene's centre (degrees).
NEW_VIEW_DEGREES = 8.0
# Motion colours are full at this percentile of the lengths that move at all, but never for less than a pixel.
FULL_MOTION, LEAST_MOTION = 98, 1.0


def contact_sheet(
    scene: Scene,
    clip: Clip,
    frames: int = 6,
    degrees: float = NEW_VIEW_DEGREES,
    backend: str = "auto",
    progress: Progress = silent,
) -> Image.Image:
    """Return an RGB picture: one row for each of `frames` used moments spread over the clip, one labelled column per `COLUMNS`.

    The new view is the moment's own camera moved to its right until it sees the scene's centre from `degrees` further.
    Colours of depth and motion have one range for the whole sheet.

    Raises:
        F4xError: clip and scene differ in frame count.
    """
    cameras = scene.cameras
    if len(clip) != len(cameras):
        raise F4xError(
            f"{clip.source}: {len(clip)} frames, but the scene has {len(cameras)}; give the scene's own clip."
        )
    used = clip.supervised
    chosen = used[np.unique(np.linspace(0, len(used) - 1, frames).round().astype(int))]
    views, news = [], []
    for done, index in enumerate(chosen):
        progress("sheet", done, len(chosen))
        time = float(cameras.times[index])
        aside = trajectory.orbit(cameras, time=time, degrees=degrees, around=time, count=1)[0]
        views.append(render(scene, cameras[int(index)], time, ("rgb", "depth", "motion"), backend))
        news.append(render(scene, aside.camera, time, ("rgb",), backend)["rgb"])
    progress("sheet", len(chosen), len(chosen))
    near, far = depth_range(view["depth"] for view in views)
    largest = _full_motion([view["motion"] for view in views])
    rows = [
        [
            clip.frames[index],
            as_bytes(view["rgb"]),
            as_bytes(new),
            colour_depth(view["depth"], near, far),
            colour_motion(view["motion"], largest),
        ]
        for index, view, new in zip(chosen, views, news, strict=True)
    ]
    return labelled_grid(rows, [str(index) for index in chosen], COLUMNS)


def _full_motion(motions: list[np.ndarray]) -> float:
    """The motion in pixels that gets the full colour."""
    lengths = np.linalg.norm(np.stack(motions), axis=-1)
    moving = lengths[lengths > LEAST_MOTION / 10]
    return max(float(np.percentile(moving, FULL_MOTION)), LEAST_MOTION) if moving.size else LEAST_MOTION
