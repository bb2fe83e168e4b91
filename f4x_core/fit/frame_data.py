"""Supervision of a fit: frames and priors as tensors, at full and at half size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from torch import Tensor

from ..clip import Clip
from ..geometry.camera import Camera
from ..priors import Priors
from ..priors.sizes import LargeMaps

# Tracks that move less surely than this carry no track loss.
TRACK_MOTION = 0.5
# A pixel that moves more surely than this is one of a moving object.
MOVING = 0.5
# Pixels of a frame that have to move for a window around them, and the window's margin: SSIM looks 5 pixels around each.
MIN_MOVING_PIXELS, WINDOW_MARGIN = 30, 8
# Pixels around what moves that a close-up supervises. Farther away dynamic Gaussians would learn to hide what static ones get wrong
# (parkour, frames held out: -.26 dB for -.05).
MOVER_EDGE = 4
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


@dataclass(frozen=True)
class Window:
    """A part of a picture, in pixels."""

    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(cls, region: Tensor, margin: int) -> Window | None:
        """Return the window with `margin` pixels around the True of `region (H,W)`, within the picture; None without any."""
        if not bool(region.any()):
            return None
        edges = []
        for axis in (0, 1):
            places = region.any(axis).nonzero()[:, 0]
            low, high = int(places[0]) - margin, int(places[-1]) + 1 + margin
            edges.append((max(low, 0), min(high, region.shape[1 - axis])))
        (left, right), (top, bottom) = edges
        return cls(left, top, right - left, bottom - top)

    def halved(self) -> Window:
        """Return the window of the picture at half the resolution."""
        return Window(self.left // 2, self.top // 2, self.width // 2, self.height // 2)

    def part(self, pixels: int, generator: torch.Generator) -> Window:
        """Return a random part of this shape with so many pixels; all of it where it has no more."""
        if self.width * self.height <= pixels:
            return self
        factor = math.sqrt(pixels / (self.width * self.height))
        width, height = max(int(factor * self.width), 1), max(int(factor * self.height), 1)
        left, top = (
            int(torch.randint(whole - own + 1, (1,), generator=generator))
            for whole, own in ((self.width, width), (self.height, height))
        )
        return Window(self.left + left, self.top + top, width, height)

    def of(self, image: Tensor) -> Tensor:
        """Return this part of `image (H,W,...)`."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width].contiguous()

    def seen_by(self, camera: Camera) -> Camera:
        """Return the camera that sees this part of what `camera` sees."""
        intrinsics = camera.intrinsics.clone()
        intrinsics[0, 2] -= self.left
        intrinsics[1, 2] -= self.top
        return Camera(intrinsics, camera.world_to_camera, self.width, self.height)


@dataclass(frozen=True)
class FrameTarget:
    """A supervised frame, or a window of it, with its priors: the goal of a drawn picture."""

    frame: int
    """Number among the supervised ones."""
    rgb: Tensor
    """(H,W,3) uint8."""
    priors: FramePriors
    hidden: Tensor | None
    """(H,W) bool: pixels that nobody saw; None where all are seen."""

    def within(self, window: Window) -> FrameTarget:
        """Return the target of a window."""
        own = self.priors
        priors = FramePriors(window.of(own.depth), window.of(own.confidence), window.of(own.motion))
        hidden = None if self.hidden is None else window.of(self.hidden)
        return FrameTarget(self.frame, window.of(self.rgb), priors, hidden)

    def near_movers(self) -> FrameTarget:
        """Return the target that supervises what moves and its edge alone: the rest counts as hidden."""
        moving, reach = (self.priors.motion > MOVING).byte().numpy(), 2 * MOVER_EDGE + 1
        far = torch.from_numpy(cv2.dilate(moving, np.ones((reach, reach), np.uint8)) == 0)
        return replace(self, hidden=far if self.hidden is None else far | self.hidden)


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

    def target(self, frame: int) -> FrameTarget:
        """Return the target of a whole frame."""
        hidden = None if self.hidden is None else self.hidden[frame]
        return FrameTarget(frame, self.rgb[frame], self.maps(frame), hidden)

    @cached_property
    def moving_windows(self) -> dict[int, Window]:
        """Frame -> the window around what moves in it; frames in which next to nothing does are left out."""
        found = {}
        for frame in range(len(self.rgb)):
            moving = self._sampled(self.large.motion(frame)) > MOVING
            window = Window.around(moving, WINDOW_MARGIN)
            if window is not None and int(moving.sum()) >= MIN_MOVING_PIXELS:
                found[frame] = window
        return found

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
