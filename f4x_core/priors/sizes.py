"""Priors of large pictures: made from smaller ones, and enlarged to the size that is fitted.

Flow, tracks and depth cost in proportion to the pixels, and what they find hardly changes with them: a track is right to a
fraction of a pixel of the size it was made at, dense depth varies smoothly between edges.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..clip.images import even_size, resize_color, resize_nearest
from ..parallel import in_threads

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors


def shrunk(clip: Clip, longer_side: int) -> Clip:
    """The clip with pictures whose longer side has at most so many pixels: itself where they have."""
    if max(clip.width, clip.height) <= longer_side:
        return clip
    wanted = round(clip.width * longer_side / max(clip.width, clip.height))
    size = even_size(clip.width, clip.height, wanted)

    def nearest(maps: np.ndarray | None) -> np.ndarray | None:
        return None if maps is None else shrunk_maps(maps, *size)

    return replace(
        clip,
        frames=np.stack(in_threads(lambda frame: resize_color(frame, *size), clip.frames)),
        cameras=None if clip.cameras is None else clip.cameras.resized(*size),
        masks=nearest(clip.masks),
        depth=nearest(clip.depth),
    )


def shrunk_maps(maps: np.ndarray, width: int, height: int) -> np.ndarray:
    """(F,height,width) of maps (F,H,W) that must not be mixed: the values at the new pixels' centres."""
    return np.stack([resize_nearest(one, width, height) for one in maps])


def enlarged(priors: Priors, width: int, height: int) -> Priors:
    """The priors for pictures of `width` x `height` pixels, without flow, which a fit does not read.

    Depth and confidence of what moves and of what stands still are enlarged by themselves, so that the two do not mix along
    an outline.
    """
    found = replace(priors, width=width, height=height, scratch={})
    for name in ("flow_forward", "flow_backward", "flow_forward_mask", "flow_backward_mask"):
        setattr(found, name, None)
    if priors.cameras is not None:
        found.cameras = priors.cameras.resized(width, height)
    if priors.tracks is not None:
        scale = np.array([width / priors.width, height / priors.height], np.float32)
        found.tracks = priors.tracks * scale
    if priors.motion is not None:
        found.motion = np.stack(in_threads(lambda one: _linear(one, width, height).astype(np.float16), priors.motion))
    still = np.zeros((len(priors.frames), priors.height, priors.width), bool)
    moving = still if priors.mask is None else priors.mask
    if priors.mask is not None:
        found.mask = np.stack(in_threads(lambda one: _linear(one, width, height) > 0.5, moving))
    if priors.depth is not None:
        maps = in_threads(
            lambda frame: _enlarged_depth(priors, moving[frame], frame, width, height), range(len(moving))
        )
        depth, confidence = zip(*maps, strict=True)
        found.depth = np.stack(depth)
        found.depth_confidence = None if priors.depth_confidence is None else np.stack(confidence)
    return found


def _linear(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height,width) float32, between the pixels of `values` (h,w)."""
    import cv2

    return cv2.resize(values.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)


def _enlarged_depth(
    priors: Priors, moving: np.ndarray, frame: int, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H,W) float32, NaN = unknown, and confidence (H,W) float16 of a frame, whose moving pixels are `moving (h,w)`."""
    assert priors.depth is not None
    depth = priors.depth[frame]
    confidence = np.ones(depth.shape) if priors.depth_confidence is None else priors.depth_confidence[frame]
    known = np.isfinite(depth)
    inverse = np.where(known, 1 / np.where(known, depth, 1), 0)
    layers = []
    for layer in (~moving, moving):
        weight, there = _linear(layer & known, width, height), _linear(layer, width, height)
        held = np.maximum(weight, 1e-6)
        values = (
            _linear(layer * inverse, width, height) / held,
            _linear(layer * known * confidence, width, height) / held,
        )
        layers.append((weight >= 0.5 * np.maximum(there, 1e-6), *values))
    inside = _linear(moving, width, height) > 0.5
    seen, inverse, confidence = (np.where(inside, b, a) for a, b in zip(*layers, strict=True))
    depth = np.where(seen, 1 / np.maximum(inverse, 1e-12), np.nan)
    return depth.astype(np.float32), np.where(seen, np.clip(confidence, 0, 1), 0).astype(np.float16)
