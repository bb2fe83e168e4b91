"""Priors of large pictures: made from smaller ones, and enlarged frame by frame to the size that is fitted.

Flow, tracks and depth cost in proportion to the pixels, and what they find hardly changes with them: a track is right to a
fraction of a pixel of the size it was made at, dense depth varies smoothly between edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..clip.images import even_size, resize_color, resize_linear, resize_nearest
from ..parallel import in_threads

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of one frame."""

    depth: np.ndarray
    """(H,W) float32 world units, NaN = unknown."""
    confidence: np.ndarray
    """(H,W) float16 in 0..1; 1 everywhere where the priors have none."""

    @property
    def known(self) -> np.ndarray:
        """(H,W) bool: pixels with a depth."""
        known: np.ndarray = np.isfinite(self.depth) & (self.depth > 0)
        return known


def shrunk(clip: Clip, longer_side: int) -> Clip:
    """Return the clip with pictures whose longer side has at most so many pixels: itself where they have."""
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


@dataclass(frozen=True, eq=False)
class LargeMaps:
    """The maps of priors at the size of the pictures that are fitted, a frame at a time.

    A long clip of large pictures has no room for all of them. Maps of that size already are returned as they are.
    """

    priors: Priors
    width: int
    height: int

    @property
    def same(self) -> bool:
        """True if the priors have the size of the pictures."""
        return (self.priors.width, self.priors.height) == (self.width, self.height)

    def mask(self, frame: int) -> np.ndarray:
        """Return the moving pixels (H,W) bool of supervised frame `frame`."""
        assert self.priors.mask is not None
        mask: np.ndarray = self.priors.mask[frame]
        return mask if self.same else resize_linear(mask, self.width, self.height) > 0.5

    def motion(self, frame: int) -> np.ndarray:
        """Return the moving score (H,W) float16 of supervised frame `frame`."""
        assert self.priors.motion is not None
        motion: np.ndarray = self.priors.motion[frame]
        return motion if self.same else resize_linear(motion, self.width, self.height).astype(np.float16)

    def depth(self, frame: int) -> DepthMap:
        """Return depth and confidence of supervised frame `frame`."""
        priors = self.priors
        assert priors.depth is not None
        depth: np.ndarray = priors.depth[frame]
        given = priors.depth_confidence
        found = DepthMap(depth, np.ones(depth.shape, np.float16) if given is None else given[frame])
        return found if self.same else self._enlarged_depth(frame, found)

    def _enlarged_depth(self, frame: int, small: DepthMap) -> DepthMap:
        """Enlarge depth and confidence of dynamic and static pixels apart, so that they do not mix along an outline."""
        priors, width, height = self.priors, self.width, self.height
        depth, confidence = small.depth, small.confidence
        moving = np.zeros(depth.shape, bool) if priors.mask is None else priors.mask[frame]
        inside = False if priors.mask is None else self.mask(frame)
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
        sure = np.where(seen, np.clip(confidence, 0, 1), 0)
        return DepthMap(depth.astype(np.float32), sure.astype(np.float16))


def moving_masks(priors: Priors, width: int, height: int) -> dict[int, np.ndarray] | None:
    """Return clip frame -> (H,W) bool of moving pixels in pictures of `width` x `height`; None while there is no mask."""
    if priors.mask is None:
        return None
    maps = LargeMaps(priors, width, height)
    return {int(frame): maps.mask(row) for row, frame in enumerate(priors.frames)}
