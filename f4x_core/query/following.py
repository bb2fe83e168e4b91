"""Masks on some frames, followed through the clip in feature space and lifted to Gaussians. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..geometry import spherical_harmonics
from ..geometry.arrays import evenly_spaced
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.view import render
from .blend_weights import blend_weight_sums, lift_masks
from .kept import Kept
from .pixels import SHOWN, coverage_by, head_map
from .score import logistic
from .segmentation import FeaturePropagation, MaskDecoder
from .smoothing import LOOKS_ALIKE, field_of_looks

KNOWN, BLOCK = 1024, 4096
"""Gaussians with scores that are enough to say what is near, and Gaussians without that are compared with them at once: a block
of distances stays small."""
UNSEEN = 1e-3
"""Blend weight in pixels up to which a Gaussian does not show in a picture."""
STAND_IN_GRID = 64
"""Columns of the grid on which rendered colour, motion and depth stand in for features that a scene lacks."""


@dataclass(frozen=True)
class FollowConfig:
    """How a mask on one frame becomes a selection for all of them."""

    lifted: int = 20
    """Frames, evenly over the clip, whose masks are lifted to Gaussians; 0 = the prompted ones alone, which is quick."""
    prompted_weight: float = 3.0
    """A prompted frame counts as so many others: its mask is the user's."""
    min_blend_weight: float = 0.05
    """Blend weight in pixels, summed over all lifted frames, below which a Gaussian's score comes from its neighbours."""
    neighbours: int = 8
    """Number of those neighbours."""
    one_kind: float = 0.9
    """A prompt means moving Gaussians alone if they hold at least this fraction of its blend weights, and static ones alone if
those do."""
    colour_weight: float = 4.0
    """World units (1 = median depth) that a colour difference of 1 is worth when neighbours are looked for."""


def follow_thing(
    scene: Scene,
    chosen: np.ndarray,
    frames: Iterable[int],
    config: FollowConfig,
    backend: str = "auto",
    progress: Progress = silent,
) -> np.ndarray:
    """(N,) scores of the thing that the Gaussians `chosen (N,)` show on clip `frames`, found in all others by how it looks.

    Superpoints know well where a thing ends on the frame that was marked, and less well what becomes of it: a fast thing is
    made of Gaussians that come and go. `chosen` comes back where it stands, where the scene has no visual features, and where
    `config` lifts no frames.
    """
    if not config.lifted or field_of_looks(scene) is None or not chosen[scene.moving].any():
        return chosen
    decoder, masks = decoder_of(scene, backend), {}
    for frame in sorted(set(frames)):
        camera, time = scene.cameras[frame], float(scene.cameras.times[frame])
        mask = coverage_by(scene, chosen, camera, time, backend) > SHOWN
        if mask.any():
            decoder.prompt(frame, mask=mask)
            masks[frame] = mask.astype(np.float32)
    return follow_masks(scene, masks, decoder, config, progress) * scene.moving if masks else chosen


def follow_masks(
    scene: Scene,
    prompted: Mapping[int, np.ndarray],
    decoder: MaskDecoder,
    config: FollowConfig,
    progress: Progress = silent,
) -> np.ndarray:
    """(N,) scores in [0, 1]: fractions of blend weights inside the `decoder`'s masks; of the unseen, their neighbours' mean.

    `prompted`: clip frame -> mask (H,W) of the frames that the decoder was prompted on. If these masks are clearly on moving or on
    static Gaussians, only those have scores.
    """
    fraction, total = lift_masks(scene, prompted, progress)
    total = config.prompted_weight * total
    inside = fraction * total
    moves = inside[scene.moving].sum() / max(inside.sum(), 1e-12)
    both = 1 - config.one_kind < moves < config.one_kind
    meant = both | (scene.moving == (moves >= config.one_kind))
    views = _VIEWS.get(scene, make=_Views)
    wanted = set(evenly_spaced(len(scene.cameras), config.lifted)) - set(prompted)
    for done, (frame, logits) in enumerate(decoder.propagate() if wanted else ()):
        progress("follow", done, len(scene.cameras))
        if frame in wanted:
            seen = views.seen(scene, frame)
            inside[seen.rows] += seen.weights * logistic(logits)[seen.pixels]
            total[seen.rows] += seen.weights
    scores = np.clip(inside / np.maximum(total, 1e-12), 0, 1)
    return _from_neighbours(scene, scores, total > config.min_blend_weight, meant, config)


class _Seen(NamedTuple):
    """The Gaussians that show in a picture of the clip."""

    rows: np.ndarray
    """(n,) int32."""
    weights: np.ndarray
    """(n,) float32: their blend weights in pixels."""
    pixels: tuple[np.ndarray, np.ndarray]
    """Row and column, (n,) int16 each, of the pixel at the centre of these weights."""


class _Views:
    """What following needs of a scene's pictures, whatever is followed; each is drawn once."""

    def __init__(self) -> None:
        self._looks: dict[int, np.ndarray] = {}
        self._seen: dict[int, _Seen] = {}

    def looks(self, scene: Scene, frame: int, backend: str = "auto") -> np.ndarray:
        """(h,w,C) float32: what the head of looks sees on clip `frame`."""
        if frame not in self._looks:
            camera, time = scene.cameras[frame], float(scene.cameras.times[frame])
            self._looks[frame] = head_map(scene, LOOKS_ALIKE, camera, time, backend)
        return self._looks[frame]

    def seen(self, scene: Scene, frame: int) -> _Seen:
        """Who shows on clip `frame`, and where."""
        if frame not in self._seen:
            height, width = scene.cameras.height, scene.cameras.width
            rows, columns = np.mgrid[:height, :width].astype(np.float32)
            layers = np.stack([np.ones_like(rows), rows, columns], -1)
            weights, *places = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, layers).T
            there = np.flatnonzero(weights > UNSEEN)
            row, column = ((place[there] / weights[there]).round().astype(np.int16) for place in places)
            self._seen[frame] = _Seen(there.astype(np.int32), weights[there], (row, column))
        return self._seen[frame]


_VIEWS: Kept[_Views] = Kept()


def decoder_of(scene: Scene, backend: str = "auto") -> MaskDecoder:
    """The decoder that needs no model: nearest neighbours in the `visual` features of the scene.

    Without them rendered colour, place, motion and depth stand in: then only what differs in these is told apart.
    """
    cameras = scene.cameras
    features = (_stand_in_features if field_of_looks(scene) is None else _head_features)(scene, backend)
    return FeaturePropagation(features, len(cameras), (cameras.height, cameras.width))


def _head_features(scene: Scene, backend: str) -> Callable[[int], np.ndarray]:
    views = _VIEWS.get(scene, make=_Views)

    def at(t: int) -> np.ndarray:
        return views.looks(scene, t, backend)

    return at


def _stand_in_features(scene: Scene, backend: str) -> Callable[[int], np.ndarray]:
    cameras = scene.cameras
    rows = max(1, round(STAND_IN_GRID * cameras.height / cameras.width))

    def at(t: int) -> np.ndarray:
        camera, time = cameras[t].resized(STAND_IN_GRID, rows), float(cameras.times[t])
        values = {"moving": scene.moving[:, None].astype(np.float32)}
        drawn = render(scene, camera, time, ("rgb", "depth", "alpha"), backend, values=values)
        inverse = 1 / np.nan_to_num(drawn["depth"], nan=np.inf)
        numbers = np.concatenate([np.clip(drawn["rgb"], 0, 1), drawn["moving"], inverse[..., None]], -1)
        angle = np.pi / 2 * numbers  # the cosine of two cells is the mean of cos(pi/2 difference): 0 for opposites
        return np.concatenate([np.cos(angle), np.sin(angle)], -1)

    return at


def _from_neighbours(
    scene: Scene, scores: np.ndarray, seen: np.ndarray, meant: np.ndarray, config: FollowConfig
) -> np.ndarray:
    """Scores (N,), 0 but for those `meant (N,)`, of whom those that no lifted frame sees get the mean of their like.

    That is of the nearest `seen (N,)` ones that move or stand as they do, in colour and in place on the first frame.
    """
    scores = scores * meant
    posed = scene.posed(float(scene.cameras.times[0]))
    places = np.concatenate([posed.means, config.colour_weight * spherical_harmonics.rgb_from_dc(posed.sh[:, 0])], 1)
    for kind in (posed.dynamic, ~posed.dynamic):
        missing, known = np.flatnonzero(kind & meant & ~seen), np.flatnonzero(kind & seen & meant)
        if not len(known):
            scores[missing] = 0
            continue
        if len(known) > KNOWN:
            known = known[np.linspace(0, len(known) - 1, KNOWN).astype(int)]
        squares = (places[known] ** 2).sum(1)
        for part in np.array_split(missing, max(1, len(missing) // BLOCK)):
            far = squares - 2 * places[part] @ places[known].T
            count = min(config.neighbours, len(known))
            near = np.argpartition(far, count - 1, axis=1)[:, :count]
            scores[part] = scores[known[near]].mean(1)
    return scores
