"""Priors of large pictures: made from smaller ones, and enlarged to the size that is fitted.

Flow, tracks and depth cost in proportion to the pixels, and what they find hardly changes with them: a track is right to a
fraction of a pixel of the size it was made at, dense depth varies smoothly between edges.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..clip.images import even_size, resize_color, resize_linear, resize_nearest
from ..parallel import in_threads

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors


FLOW = ("flow_forward", "flow_backward", "flow_forward_mask", "flow_backward_mask")
"""Priors that a fit does not read."""


def shrunk(clip: Clip, longer_side: int) -> Clip:
    """The clip with pictures whose longer side has at most so many pixels: itself where they have."""
    if max(clip.width, clip.height) <= longer_side:
        return clip
    wanted = round(clip.width * longer_side / max(clip.width, clip.height))
    width, height = even_size(clip.width, clip.height, wanted)

    return replace(
        clip,
        frames=np.stack(in_threads(lambda frame: resize_color(frame, width, height), clip.frames)),
        cameras=None if clip.cameras is None else clip.cameras.resized(width, height),
        masks=None if clip.masks is None else resize_nearest(clip.masks, width, height),
        depth=None if clip.depth is None else resize_nearest(clip.depth, width, height),
        hidden=None if clip.hidden is None else resize_nearest(clip.hidden, width, height),
    )


def enlarged(priors: Priors, width: int, height: int) -> Priors:
    """The priors for pictures of `width` x `height` pixels, without `FLOW`.

    Depth and confidence of what moves and of what stands still are enlarged by themselves, so that the two do not mix along
    an outline.
    """
    found = replace(priors, width=width, height=height, scratch={})
    for name in FLOW:
        setattr(found, name, None)
    if priors.cameras is not None:
        found.cameras = priors.cameras.resized(width, height)
    if priors.tracks is not None:
        scale = np.array([width / priors.width, height / priors.height], np.float32)
        found.tracks = priors.tracks * scale
    if priors.people is not None:
        found.people = resize_nearest(priors.people, width, height)
    if priors.people_probability is not None:
        found.people_probability = _enlarged_maps(priors.people_probability, width, height)
    if priors.people_joints is not None:
        scale = np.array([width / priors.width, height / priors.height, 1], np.float32)
        found.people_joints = priors.people_joints * scale
    if priors.motion is not None:
        found.motion = _enlarged_maps(priors.motion, width, height)
    if priors.mask is not None:
        found.mask = _enlarged_maps(priors.mask, width, height)
    if priors.depth is not None:
        size = (len(priors.depth), height, width)
        depth, confidence = np.empty(size, np.float32), np.empty(size, np.float16)

        def write(frame: int) -> None:
            depth[frame], confidence[frame] = _enlarged_depth(priors, found, frame)

        in_threads(write, range(len(depth)))
        found.depth, found.depth_confidence = depth, None if priors.depth_confidence is None else confidence
    return found


def _enlarged_maps(maps: np.ndarray, width: int, height: int) -> np.ndarray:
    """Maps (F,H,W) of numbers or bools (true from one half on) in another size.

    They are written where they stay: a list of them beside their stack would take twice the memory of a long clip.
    """
    found = np.empty((len(maps), height, width), maps.dtype)

    def write(frame: int) -> None:
        large = resize_linear(maps[frame], width, height)
        found[frame] = large > 0.5 if maps.dtype == bool else large

    in_threads(write, range(len(maps)))
    return found


def _enlarged_depth(priors: Priors, found: Priors, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H,W) float32, NaN = unknown, and confidence (H,W) float16 of a frame, by the enlarged mask of `found`."""
    assert priors.depth is not None
    depth, width, height = priors.depth[frame], found.width, found.height
    confidence = np.ones(depth.shape) if priors.depth_confidence is None else priors.depth_confidence[frame]
    moving = np.zeros(depth.shape, bool) if priors.mask is None else priors.mask[frame]
    inside = False if found.mask is None else found.mask[frame]
    known = np.isfinite(depth)
    inverse = np.where(known, 1 / np.where(known, depth, 1), 0)
    layers = []
    for layer in (~moving, moving):
        weight, there = (resize_linear(part, width, height) for part in (layer & known, layer))
        held = np.maximum(weight, 1e-6)
        values = (resize_linear(layer * part, width, height) / held for part in (inverse, known * confidence))
        layers.append((weight >= 0.5 * np.maximum(there, 1e-6), *values))
    seen, inverse, confidence = (np.where(inside, b, a) for a, b in zip(*layers, strict=True))
    depth = np.where(seen, 1 / np.maximum(inverse, 1e-12), np.nan)
    return depth.astype(np.float32), np.where(seen, np.clip(confidence, 0, 1), 0).astype(np.float16)
