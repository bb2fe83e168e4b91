"""What each frame of a clip shows of a scene: how the cells of the picture appear, and which Gaussians show where.

Drawn once for each scene, whatever is followed through it. Needs numpy alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..features.text import unit
from ..geometry.arrays import evenly_spaced
from ..scene import Scene
from ..scene.view import render
from .blend_weights import blend_weight_sums
from .kept import Kept
from .pixels import cell_camera
from .segmentation import shrink
from .smoothing import LOOKS_ALIKE, field_of_looks

FAST = 0.008
"""Widths of the picture per frame at which a thing is fast; from there on speeds hardly differ in appearance."""
CUES = {"speed": 0.8, "moving": 0.5, "depth": 1.0, "rgb": 1.0}
"""What a cell shows beside its visual features, and how much each of its numbers weighs against all of these. Visual features see
their surroundings as well; these cues tell where a thing ends. True masks that are followed so have a mean IoU of .78 on the four
filmed clips that chose (camel, dog, parkour, breakdance; .75 without the cues) and of .77 on four that were not looked at (.69)."""
DIRECTIONS, DIRECTION_FRAMES = 16, 3
"""Principal directions of appearance that are kept, and frames, evenly over the clip, from which they come."""
GRID = 64
"""Columns of the grid of cells where a scene has no visual features."""
UNSEEN = 1e-3
"""Blend weight in pixels up to which a Gaussian does not show in a picture."""


class Seen(NamedTuple):
    """The Gaussians that show in a picture of the clip."""

    rows: np.ndarray
    """(n,) int32."""
    weights: np.ndarray
    """(n,) float32: their blend weights in pixels."""
    pixels: tuple[np.ndarray, np.ndarray]
    """Row and column, (n,) int16 each, of the pixel at the centre of these weights."""


class Views:
    """Pictures of one scene from the clip's cameras, each drawn when it is first asked for."""

    def __init__(self) -> None:
        self._appearance: dict[int, np.ndarray] = {}
        self._directions = np.zeros((0, 0), np.float32)
        self._seen: dict[int, Seen] = {}

    def appearance(self, scene: Scene, frame: int, backend: str = "auto") -> np.ndarray:
        """Return (h,w,C) float32, the appearance of the cells of clip `frame`, compared by the cosine; C <= `DIRECTIONS`."""
        if not self._directions.size:
            frames = evenly_spaced(len(scene.cameras), DIRECTION_FRAMES)
            shown = np.stack([_cells(scene, t, backend) for t in frames])
            flat = shown.reshape(-1, shown.shape[-1])
            self._directions = np.linalg.eigh(flat.T @ flat)[1][:, -DIRECTIONS:]  # not centred: cosines are about 0
            self._appearance = dict(zip(frames.tolist(), shown @ self._directions, strict=True))
        if frame not in self._appearance:
            self._appearance[frame] = _cells(scene, frame, backend) @ self._directions
        return self._appearance[frame]

    def seen(self, scene: Scene, frame: int) -> Seen:
        """Return the Gaussians that show on clip `frame`, and their places."""
        if frame not in self._seen:
            height, width = scene.cameras.height, scene.cameras.width
            rows, columns = np.mgrid[:height, :width].astype(np.float32)
            layers = np.stack([np.ones_like(rows), rows, columns], -1)
            weights, *places = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, layers).T
            there = np.flatnonzero(weights > UNSEEN)
            row, column = ((place[there] / weights[there]).round().astype(np.int16) for place in places)
            self._seen[frame] = Seen(there.astype(np.int32), weights[there], (row, column))
        return self._seen[frame]


_VIEWS: Kept[Views] = Kept()


def views_of(scene: Scene) -> Views:
    """Return the pictures of a scene, kept as long as it lives."""
    return _VIEWS.get(scene, make=Views)


def _cells(scene: Scene, frame: int, backend: str) -> np.ndarray:
    """Return (h,w,C) float32: the visual features, if any, and `CUES` of each cell of clip `frame`, all of about one norm."""
    field, path = field_of_looks(scene), scene.cameras
    grid = (max(1, round(GRID * path.height / path.width)), GRID) if field is None else field.spec(LOOKS_ALIKE).grid
    camera, time = cell_camera(path[frame], grid), float(path.times[frame])
    channels = ("rgb", "depth", "motion", *(() if field is None else ("latent",)))
    drawn = render(scene, camera, time, channels, backend, values={"moving": scene.moving[:, None].astype(np.float32)})
    cues = {
        "speed": np.tanh(np.linalg.norm(drawn["motion"], axis=-1, keepdims=True) / (FAST * camera.width)),
        "moving": drawn["moving"],
        "depth": 1 / (1 + np.nan_to_num(drawn["depth"], nan=np.inf)[..., None]),  # 1/2 at the scene's median depth
        "rgb": np.clip(drawn["rgb"], 0, 1),
    }
    angle = np.pi / 2 * shrink(np.concatenate([*cues.values()], -1), grid)  # numbers 0 and 1 have cosine 0
    weight = np.repeat([*CUES.values()], [cue.shape[-1] for cue in cues.values()])
    shown = [weight * np.cos(angle), weight * np.sin(angle)]
    if field is not None:
        shown.append(unit(field.decode(LOOKS_ALIKE, shrink(drawn["latent"], grid))))
    return np.concatenate(shown, -1, dtype=np.float32)
