"""Supervision of a fit: frames and priors as tensors, at full and at half size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..clip import Clip
from ..priors import Priors
from ..priors.sizes import LargeMaps

# Tracks that move less surely than this carry no track loss.
TRACK_MOTION = 0.5
# Two frames are compared along tracks when they share at least this many.
MIN_SHARED_TRACKS = 8


@dataclass(frozen=True)
class FramePriors:
    """The priors of one frame at the size of its picture."""

    depth: Tensor
    """(H,W) float32, NaN = unknown."""
    confidence: Tensor
    """(H,W) float16."""
    motion: Tensor
    """(H,W) float16 moving score."""


@dataclass
class FrameData:
    """Supervision at one resolution: F frames of H x W pixels, and the priors that belong to them."""

    rgb: Tensor
    """(F,H,W,3) uint8."""
    large: LargeMaps
    """The priors, at `step` times the resolution."""
    width: int
    height: int
    hidden: Tensor | None = None
    """(F,H,W) bool: pixels that nobody saw; None where all are seen."""
    step: int = 1
    """Pixels of `large` from one pixel to the next."""

    def seen(self, frame: int) -> Tensor | None:
        """Return (H,W) float32 1 where the frame was seen; None where all of it was."""
        return None if self.hidden is None else (~self.hidden[frame]).float()

    def maps(self, frame: int) -> FramePriors:
        """Return the priors of a frame; where nobody saw it, depth is unknown and nothing moves."""
        found = self.large.depth(frame)
        depth, confidence, motion = map(self._sampled, (found.depth, found.confidence, self.large.motion(frame)))
        if self.hidden is None:
            return FramePriors(depth, confidence, motion)
        hidden = self.hidden[frame]
        return FramePriors(
            depth.masked_fill(hidden, torch.nan), confidence.masked_fill(hidden, 0), motion.masked_fill(hidden, 0)
        )

    def _sampled(self, large: np.ndarray) -> Tensor:
        """Return (H,W) of a map at the size of `large`."""
        rows, columns = (slice(0, self.step * size, self.step) for size in (self.height, self.width))
        return torch.from_numpy(np.ascontiguousarray(large[rows, columns]))

    @classmethod
    def full(cls, clip: Clip, priors: Priors) -> FrameData:
        """Return the supervised frames at the fitted size."""
        frames = clip.frames if len(priors.frames) == len(clip) else clip.frames[priors.frames]  # no copy of all
        rgb = torch.from_numpy(np.require(frames, requirements=("C", "W")))
        hidden = None if clip.hidden is None else torch.from_numpy(clip.hidden[priors.frames])
        return cls(rgb, LargeMaps(priors, clip.width, clip.height), clip.width, clip.height, hidden)

    def halved(self) -> FrameData:
        """Half the resolution: colours averaged over 2 x 2 pixels, priors sampled or enlarged less."""
        width, height = self.width // 2, self.height // 2
        crop = self.rgb[:, : 2 * height, : 2 * width].reshape(len(self.rgb), height, 2, width, 2, 3)
        rgb = torch.stack([frame.float().mean((1, 3)).round().byte() for frame in crop])
        hidden = None
        if self.hidden is not None:  # a mean of four pixels is seen where all of them are
            hidden = self.hidden[:, : 2 * height, : 2 * width].reshape(len(self.rgb), height, 2, width, 2).any(4).any(2)
        if self.large.same:
            return FrameData(rgb, self.large, width, height, hidden, 2 * self.step)
        return FrameData(rgb, LargeMaps(self.large.priors, width, height), width, height, hidden)


@dataclass(frozen=True)
class MovingTracks:
    """The tracks of moving objects, in pixels of the priors."""

    points: Tensor
    """(F,P,2) float32."""
    visible: Tensor
    """(F,P) bool: seen there, and surely moving."""
    width: int
    height: int

    @classmethod
    def of(cls, priors: Priors) -> MovingTracks:
        """Take the tracks of the priors; none where the priors have no tracks."""
        size = priors.width, priors.height
        if priors.tracks is None:
            frames = len(priors.frames)
            return cls(torch.zeros(frames, 0, 2), torch.zeros(frames, 0, dtype=torch.bool), *size)
        shape = priors.tracks.shape[:2]
        visible = priors.tracks_visible if priors.tracks_visible is not None else np.zeros(shape, bool)
        motion = priors.tracks_motion if priors.tracks_motion is not None else np.zeros(shape[1])
        return cls(torch.from_numpy(priors.tracks), torch.from_numpy(visible & (motion > TRACK_MOTION)[None]), *size)

    def random_partner(self, frame: int, generator: torch.Generator) -> int | None:
        """Return a random other frame that shares enough tracks with `frame`; None where there is none."""
        shared = (self.visible & self.visible[frame]).sum(1)  # (F,)
        shared[frame] = 0
        candidates = (shared >= MIN_SHARED_TRACKS).nonzero()[:, 0]
        if len(candidates) == 0:
            return None
        return int(candidates[torch.randint(len(candidates), (1,), generator=generator)])

    def shared(self, frame: int, partner: int) -> tuple[Tensor, Tensor]:
        """Return (n,2) pixels of the tracks that both frames see: in `frame`, and in `partner`."""
        both = self.visible[frame] & self.visible[partner]
        return self.points[frame, both], self.points[partner, both]
