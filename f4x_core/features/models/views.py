"""Cameras and depth of a whole clip from a model that takes a few frames at once and predicts each batch in its own world.

The first pass predicts evenly spaced keyframes of the whole clip, so that nothing can drift. Then every stretch between
keyframes is predicted and aligned to them: each camera is placed relative to the keyframe before and to the one after it,
in the keyframes' scale, and the two poses are blended. A clip too long for one pass of keyframes is solved in the same way, level
by level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np

from ...geometry import pose, quaternion
from ...geometry.arrays import evenly_spaced


@dataclass(frozen=True)
class Views:
    """Cameras and depth that a model predicts for N images of h x w pixels, all in one world of arbitrary place and scale."""

    intrinsics: np.ndarray
    """(N, 3, 3) float64 pixels."""
    world_to_camera: np.ndarray
    """(N, 4, 4) float64 rigid matrices, OpenCV axes."""
    depth: np.ndarray
    """(N, h, w) float32 z depth > 0."""
    confidence: np.ndarray
    """(N, h, w) float32 0..1."""

    def __len__(self) -> int:
        return len(self.depth)

    def poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return camera-to-world poses: quaternions (N, 4) and centres (N, 3)."""
        return pose.invert(*pose.from_matrix(self.world_to_camera))


def predict_in_one_world(predict: Callable[[np.ndarray], Views], count: int, max_views: int) -> Views:
    """Return views of frames 0..count-1 in one world; `predict(indices) -> Views` takes at most `max_views >= 3` frames at once."""
    frames = np.arange(count)
    if count <= max_views:
        return predict(frames)
    stretches = ceil((count - 1) / (max_views - 1))
    inner = max((max_views - 1) // stretches, 1)  # a clip of few stretches affords more keyframes than their ends
    keys = evenly_spaced(count, stretches * inner + 1)
    known = predict_in_one_world(lambda chosen: predict(keys[chosen]), len(keys), max_views)
    parts = []
    for start in range(0, len(keys) - 1, inner):
        held = slice(start, start + inner + 1)
        inside = frames[keys[held][0] : keys[held][-1] + 1]
        part = align_to_keyframes(predict(inside), inside, _take(known, held), keys[held])
        parts.append(part if start == 0 else _take(part, slice(1, None)))
    return Views(*(np.concatenate(arrays) for arrays in zip(*(vars(part).values() for part in parts), strict=True)))


def align_to_keyframes(views: Views, frames: np.ndarray, known: Views, keys: np.ndarray) -> Views:
    """Return `views` of `frames` in the world of `known`, the views of the keyframes `keys` (the first and last frame included).

    At the keyframes cameras and median depth become those of `known`.
    """
    rows = np.searchsorted(frames, keys)
    ratios = np.array([_scale(views.depth[row], views.confidence[row], known, i) for i, row in enumerate(rows)])
    (q, center), (known_q, known_center) = views.poses(), known.poses()
    place = np.interp(frames, keys, np.arange(len(keys)))
    before = np.minimum(place.astype(int), len(keys) - 2)
    sides = []
    for side in (before, before + 1):
        turn = quaternion.multiply(known_q[side], quaternion.conjugate(q[rows[side]]))
        offset = np.exp(ratios.mean()) * quaternion.rotate(turn, center - center[rows[side]])
        sides.append((quaternion.multiply(turn, q), known_center[side] + offset))
    (q_before, center_before), (q_after, center_after) = sides
    fraction = (place - before)[:, None]
    turned = quaternion.slerp(q_before, q_after, fraction)
    centers = (1 - fraction) * center_before + fraction * center_after
    scale = np.exp(np.interp(frames, keys, ratios))[:, None, None]
    return Views(
        views.intrinsics,
        pose.to_matrix(*pose.invert(turned, centers)),
        (views.depth * scale).astype(np.float32),
        views.confidence,
    )


def _scale(depth: np.ndarray, confidence: np.ndarray, known: Views, index: int) -> float:
    """Log of what brings `depth (h, w)` to the known one: median over the half of the pixels that both are surest of."""
    sure = np.minimum(confidence, known.confidence[index])
    sure = sure >= np.median(sure)
    return float(np.median(np.log(known.depth[index][sure] / depth[sure])))


def _take(views: Views, chosen: slice) -> Views:
    return Views(*(array[chosen] for array in vars(views).values()))
