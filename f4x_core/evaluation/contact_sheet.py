"""One picture that shows a scene: input, render, depth, views from the side and from above, and motion of a few moments."""

from __future__ import annotations

import numpy as np
from PIL import Image

from ..clip import Clip
from ..clip.images import as_bytes
from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.moments import draw_moments
from ..scene.visualise import colour_depth, colour_motion, depth_range, labelled_grid

COLUMNS = ("input", "render", "depth", "from the right", "from above", "motion")
# Full colour is the motion at this percentile of all moving pixels, but at least this many pixels per frame.
FULL_MOTION, MIN_MOTION = 98, 1.0


def contact_sheet(
    scene: Scene, clip: Clip, frames: int = 6, backend: str = "auto", progress: Progress = silent
) -> Image.Image:
    """Return an RGB picture: one row for each of `frames` used moments spread over the clip, one labelled column per `COLUMNS`.

    The views aside are the moment's own camera swung to its right and to above it about the scene's
    centre (`scene.moments`). Colours of depth and motion have one range for the whole sheet.

    Raises:
        F4xError: clip and scene differ in frame count.
    """
    if len(clip) != len(scene.cameras):
        raise F4xError(
            f"{clip.source}: {len(clip)} frames, but the scene has {len(scene.cameras)}; give the scene's own clip."
        )
    used = clip.supervised
    chosen = used[evenly_spaced(len(used), frames)]
    moments = draw_moments(scene, chosen, backend=backend, progress=progress)
    near, far = depth_range(moment.depth for moment in moments)
    largest = _full_motion([moment.motion for moment in moments])
    rows = [
        [
            clip.frames[moment.index],
            as_bytes(moment.rgb),
            colour_depth(moment.depth, near, far),
            as_bytes(moment.right),
            as_bytes(moment.above),
            colour_motion(moment.motion, largest),
        ]
        for moment in moments
    ]
    return labelled_grid(rows, [str(moment.index) for moment in moments], COLUMNS)


def _full_motion(motions: list[np.ndarray]) -> float:
    """Return the motion in pixels per frame that gets the full colour."""
    lengths = np.linalg.norm(np.stack(motions), axis=-1)
    moving = lengths[lengths > MIN_MOTION / 10]
    return max(float(np.percentile(moving, FULL_MOTION)), MIN_MOTION) if moving.size else MIN_MOTION
