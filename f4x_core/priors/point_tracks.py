"""Point tracks of a clip and which of them are static: what cameras are solved from. Needs numpy alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .folder import Priors

STATIC_MOTION = 0.5
"""Tracks with a motion score below this are static: cameras are solved from them."""


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Point tracks over F frames."""

    uv: np.ndarray
    """(F, N, 2) pixels."""
    visible: np.ndarray
    """(F, N) bool."""
    static: np.ndarray
    """(N,) bool."""

    @classmethod
    def of(cls, priors: Priors) -> PointTracks:
        """Return the tracks of `priors`, none where it has none."""
        if priors.tracks is None or priors.tracks_visible is None:
            frames = len(priors.frames)
            return cls(np.zeros((frames, 0, 2), np.float32), np.zeros((frames, 0), bool), np.zeros(0, bool))
        motion = priors.tracks_motion
        static = np.ones(priors.tracks.shape[1], bool) if motion is None else motion < STATIC_MOTION
        return cls(priors.tracks, priors.tracks_visible, static)

    @classmethod
    def all_static(cls, uv: np.ndarray, visible: np.ndarray) -> PointTracks:
        """Return tracks that are all taken to be static."""
        return cls(uv, visible, np.ones(uv.shape[1], bool))

    def __len__(self) -> int:
        return len(self.uv)

    @property
    def seen(self) -> np.ndarray:
        """(F, N) bool: visible and static."""
        return self.visible & self.static

    def of_frames(self, frames: np.ndarray) -> PointTracks:
        """Return the same tracks in some of the frames."""
        return PointTracks(self.uv[frames], self.visible[frames], self.static)
